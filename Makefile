# Everything a fresh machine needs: Python 3.10 to 3.14 with venv, and make.
#   make demo        train a walker and write its rollout as USD, GIF and a page
#   make test        run the default test suite (make fast: without parity; make parity: these alone)
#   make lint        check style (make format: repair it)
#   make types       check types (pyright)
#   make licences    check the licences of everything that is installed with warpvox
#   make packaging   install the wheel into clean environments of all Pythons that are found
#   make lowest      run the tests with the oldest versions that pyproject.toml allows
#   make slow        run the tests that take long
#   make coverage    run the default tests and say which lines they reach: build/report/coverage/index.html
#   make lab         run the tests of what is built on warpvox by its public names: lab/ and benchmarks/
#   make bench       measure beside EvoGym and compare with the figures of the documentation
#   make reference   make a Python with EvoGym 2.0.0 in build/reference (needs python3.10)
#   make audit       ask the advisory database about the pinned versions (pip-audit)
#   make lock        make constraints.txt and locks/ anew (UPGRADE=1: with the newest versions)
#   make ptxas       fetch NVIDIA's assembler into build/ptxas, for tests of CUDA kernels (Linux, x86-64; 52 MB)
#   make tables      write the keys of all commands into docs/commands.md
#   make notebooks   run the notebooks of examples/ and keep what they show
#   make charts      draw the charts of docs/performance.md and docs/results.md from their tables
#   make results     renew the page of results from the zoo and the tables of lab/zoo
#   make release     build both distributions, check them, and say what an upload would send
#   make docs        build the documentation into site/ and test it
#   make clean       remove what builds leave behind (make distclean: .venv as well)
# PYTHON=python3.12 make demo   chooses the interpreter that .venv is made from.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# What a first look needs: warpvox without tools and tests, where these are not there already.
FIRST := $(or $(wildcard $(STAMP)),$(VENV)/.first)
# On all cores; `make test JOBS=0` in one process.
JOBS ?= auto
# A file stays on one process, which makes its fixtures once; tests/conftest.py says which files go first.
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder
PIP := $(BIN)/python -m pip install --disable-pip-version-check
# Tools of the maintainers have an environment of their own: .venv cannot be made while the locks are out of date.
TOOLS := build/tools
UV := $(TOOLS)/bin/uv
# ptxas: not in .venv, because the compiler's package asks for other versions of what torch's CUDA builds pin.
PTXAS := $(if $(filter Linux-x86_64,$(shell uname -s)-$(shell uname -m)),build/ptxas/.installed)
TOOL := $(UV) tool run --python $(TOOLS)/bin/python
REPORT := build/report
REFERENCE := build/reference/bin/python
COVERAGE := build/coverage
COMPILE := $(UV) pip compile --quiet --no-python-downloads --python-version 3.10 --universal \
  --no-annotate --custom-compile-command "make lock" pyproject.toml
HASHED := $(COMPILE) --generate-hashes -c constraints.txt --no-emit-package torch

.PHONY: help install demo test ptxas fast slow parity coverage lab bench reference lint types format licences packaging lowest audit lock release docs tables charts notebooks pictures results clean distclean
.DEFAULT_GOAL := help

help:
	@sed -n '2,24s/^# *//p' Makefile

install: $(STAMP)

# The stamp is written last: an interrupted installation is repeated, a finished one is not. Everything but torch has to
# have a hash of locks/; which build of torch fits depends on the machine. The lock is complete, so that nothing is
# resolved here (--no-deps), and `pip check` says so.
$(STAMP): locks/test.txt
$(VENV)/.first: locks/run.txt
$(STAMP) $(VENV)/.first: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 15))' || \
	  { echo "warpvox needs Python 3.10 to 3.14; choose one with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --no-deps --require-hashes -r $(filter locks/%,$^)
	$(PIP) -c constraints.txt torch
	$(PIP) --no-deps --no-build-isolation -e .
	$(BIN)/python -m pip check
	@touch $@

demo: $(FIRST)
	$(BIN)/warpvox demo

test: $(STAMP) $(PTXAS)
	$(PYTEST)

fast: $(STAMP)
	$(PYTEST) -m "not slow and not gpu and not packaging and not parity"

parity: $(STAMP)
	$(PYTEST) -m parity

# Not in the wheel, and by public names only (tests/test_architecture.py).
lab: $(STAMP)
	$(PYTEST) lab benchmarks

slow: $(STAMP) $(PTXAS)
	$(PYTEST) -m "slow and not gpu and not packaging"

# Beside .venv, whose lock is that of the tests. What Warp compiles is not Python's to run: pyproject.toml leaves it out.
coverage: $(STAMP) $(COVERAGE)/.installed
	PYTHONPATH=$(COVERAGE) $(PYTEST) $(foreach folder,warpvox kernels envs algos configs,--cov=$(folder)) \
	  --cov-report=term:skip-covered --cov-report=html:$(REPORT)/coverage

$(COVERAGE)/.installed: | $(STAMP)
	$(PIP) --quiet --no-deps --upgrade --target $(COVERAGE) pytest-cov==7.1.0 coverage==7.17.4
	@touch $@

# Ratios are compared, not rates: machines differ, and so does one machine from minute to minute.
bench: $(STAMP) $(REFERENCE)
	$(BIN)/python benchmarks/peer.py
	$(BIN)/python benchmarks/tasks.py
	$(BIN)/python benchmarks/learning.py --threads 2
	$(BIN)/python docs/compare_figures.py $(REPORT)

# Where tests and benchmarks look for EvoGym; its release was built against NumPy 1.
reference: $(REFERENCE)

$(REFERENCE):
	rm -rf build/reference
	python3.10 -m venv build/reference
	$@ -m pip install --quiet --disable-pip-version-check evogym==2.0.0 'numpy<2' || { rm -rf build/reference; exit 1; }

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

licences: $(STAMP)
	$(BIN)/python -m pytest tests/supply/test_licences.py

# WARPVOX_PACKAGING=full make packaging   installs torch everywhere, not only into the Python of .venv.
packaging: $(STAMP)
	$(BIN)/python -m pytest -m packaging -v -rs --durations=0

# Not the licences and pins, which are those of .venv.
lowest: $(UV) $(PTXAS)
	$(UV) venv --quiet --clear --python $(TOOLS)/bin/python build/lowest
	$(UV) pip install --quiet --python build/lowest/bin/python --resolution lowest-direct -e ".[dev,view,search,sb3]"
	$(PYTEST:$(BIN)/%=build/lowest/bin/%) --ignore tests/supply

# Strict: a package that cannot be looked up is a failure, not a clean bill.
audit: $(UV)
	$(TOOL) pip-audit==2.10.1 --strict --no-deps --disable-pip -r constraints.txt

# One resolution for all Pythons and platforms; versions stay as they are unless UPGRADE is given.
lock: $(UV)
	$(COMPILE) $(if $(UPGRADE),--upgrade) --all-extras -o constraints.txt
	$(HASHED) --extra view -o locks/run.txt
	$(HASHED) --extra dev --extra view --extra search --extra ray --extra analysis --extra export --extra sb3 -o locks/test.txt
	$(HASHED) --extra docs -o locks/docs.txt
	$(HASHED) --all-extras -o locks/all.txt
	printf 'nvidia-cuda-nvcc\n' | $(COMPILE:pyproject.toml=-) $(if $(UPGRADE),--upgrade) --generate-hashes --no-deps -o locks/ptxas.txt

ptxas: $(PTXAS)

build/ptxas/.installed: locks/ptxas.txt | $(STAMP)
	$(PIP) --quiet --no-deps --require-hashes --upgrade --target build/ptxas -r locks/ptxas.txt
	@touch $@

$(UV):
	$(PYTHON) -m venv $(TOOLS)
	$(TOOLS)/bin/python -m pip install --quiet --disable-pip-version-check uv==0.13.9

# .github/workflows/release.yml uploads what a tag has built, by trusted publishing; nothing is uploaded from here.
release: $(UV)
	rm -rf dist
	$(UV) build --quiet --python $(TOOLS)/bin/python --out-dir dist
	$(TOOL) twine==7.0.0 check --strict dist/*
	$(TOOL) check-wheel-contents==0.6.3 dist/*.whl
	@mkdir -p $(REPORT)
	@ls dist/*.whl | sed 's/.*warpvox-\([^-]*\)-.*/\1/' > $(REPORT)/version
	@echo "would upload to https://pypi.org/project/warpvox/$$(cat $(REPORT)/version)/:"; ls -l dist | sed 1d

docs: $(STAMP)
	$(PIP) --quiet --no-deps --require-hashes -r locks/docs.txt
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	WARPVOX_SITE=site $(BIN)/python -m pytest tests/docs/test_site.py

tables: $(STAMP)
	$(BIN)/python docs/key_tables.py

notebooks: $(STAMP)
	$(BIN)/python docs/notebooks.py

# Draws the charts of the pages of performance and results from their tables.
charts: $(STAMP)
	$(BIN)/python docs/charts.py

# Makes the pictures of the documentation anew, of three runs of a walker; takes some minutes.
pictures: $(STAMP)
	$(BIN)/python docs/pictures.py

# Renews the page of results.
results: $(STAMP)
	$(BIN)/python -m lab.zoo.results

# Removes what builds and runs of tools leave behind; keeps .venv and outputs/.
clean:
	rm -rf build dist site *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

# Also removes the virtual environment.
distclean: clean
	rm -rf $(VENV)
