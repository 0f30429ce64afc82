# Everything a fresh machine needs: Python >= 3.10 with venv, and make.
#   make demo   train a walker and write its rollout as USD, GIF and a page
#   make test   run the default test suite
#   make lint   check style (make format: repair it)
#   make docs   build the documentation into site/ and check its links
#   make clean  remove what builds leave behind (make distclean: .venv as well)
# PYTHON=python3.12 make demo   chooses the interpreter that .venv is made from.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PIP := $(BIN)/python -m pip install --disable-pip-version-check

.PHONY: help install demo test lint format docs pictures clean distclean
.DEFAULT_GOAL := help

help:
	@sed -n '2,7s/^# *//p' Makefile

install: $(STAMP)

# The stamp is written last: an interrupted installation is repeated, a finished one is not. torch comes first
# because it is by far the largest download: if it fails, it fails early.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "warpvox needs Python >= 3.10; choose one with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) -c constraints.txt torch
	$(PIP) -c constraints.txt -e ".[dev,view]"
	@touch $@

demo: $(STAMP)
	$(BIN)/warpvox demo

test: $(STAMP)
	$(BIN)/python -m pytest

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(STAMP)
	$(PIP) --quiet -c constraints.txt -e ".[docs]"
	$(BIN)/python -m mkdocs build --strict

# Makes the pictures of the documentation anew, of three runs of a walker; takes some minutes.
pictures: $(STAMP)
	$(BIN)/python docs/pictures.py

# Removes what builds and runs of tools leave behind; keeps .venv and outputs/.
clean:
	rm -rf build dist site *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

# Also removes the virtual environment.
distclean: clean
	rm -rf $(VENV)
