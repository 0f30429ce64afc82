"""The house has layers; these tests keep them. See CONTRIBUTING.md for what belongs where."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAPPED = ("kernels", "envs", "algos", "configs")
MAX_LINES = 600

CORE = ("errors", "system", "types", "examples", "io", "design", "world", "contact_order", "compile")
HEAVY = {"torch", "warp", "hydra", "omegaconf", "rsl_rl", "gymnasium", "matplotlib", "pxr"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] in MAPPED:
        parts = ("warpvox", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {module_name(path): path for folder in ("warpvox", *MAPPED) for path in sorted((ROOT / folder).rglob("*.py"))}
ALL_FILES = [*SOURCES.values(), *sorted((ROOT / "tests").rglob("*.py"))]


def drawn_layers() -> list[list[str]]:
    """The drawing of CONTRIBUTING.md: a line a layer, the lowest first."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    drawing = text.partition("<!-- layers -->")[2].partition("\n\n| ")[0]
    return [line.split(",") for line in drawing.replace(" ", "").split("\n") if line]


LAYERS = [[f"warpvox.{name}" for name in names] for names in drawn_layers()]
ROOMS = sorted((name for names in LAYERS for name in names), key=len, reverse=True)


def room(module: str) -> str | None:
    """The entry of the drawing that a module belongs to: the longest that begins its name."""
    return next((name for name in ROOMS if module == name or module.startswith(name + ".")), None)


def layer(module: str) -> int | None:
    return next((number for number, names in enumerate(LAYERS) if room(module) in names), None)


def for_type_checkers_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def imports(tree: ast.AST, *, inside_functions: bool = True) -> Iterator[tuple[int, str]]:
    """Yield (line, module) for all imports; ``from package import module`` counts as the module."""
    for node in ast.iter_child_nodes(tree):
        if for_type_checkers_only(node):
            continue
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield node.lineno, full if full in SOURCES else node.module
        elif inside_functions or not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            yield from imports(node, inside_functions=inside_functions)


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def test_the_drawing_shows_every_module_and_nothing_else() -> None:
    modules = set(SOURCES) - {"warpvox"}
    missing = sorted(name for name in modules if room(name) is None)
    assert not missing, f"draw these in CONTRIBUTING.md: {missing}"
    assert {room(name) for name in modules} == set(ROOMS), "CONTRIBUTING.md draws what does not exist"
    assert len(set(ROOMS)) == len(ROOMS)


@pytest.mark.parametrize("module", sorted(set(SOURCES) - {"warpvox"}))
def test_no_layer_imports_a_later_one(module: str) -> None:
    own = layer(module)
    assert own is not None
    for line, target in imports(parse(SOURCES[module])):
        place = f"{SOURCES[module].relative_to(ROOT)}:{line}"
        if target == "warpvox":
            # the package's face imports everything; only the command line, the last layer, may look at it
            assert own >= layer("warpvox.cli"), f"{place} imports warpvox itself instead of the module it needs"
        elif target.startswith("warpvox."):
            other = layer(target)
            assert other is not None, f"{place} imports {target}, which has no layer"
            assert other <= own, f"{place} imports {target}, which belongs to a later layer"


@pytest.mark.parametrize("path", ALL_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_mapped_folders_are_imported_by_their_full_name(path: Path) -> None:
    # `import kernels.x` works when the root is on sys.path and registers every Warp module twice
    for line, target in imports(parse(path)):
        assert target.split(".")[0] not in MAPPED, f"{path.relative_to(ROOT)}:{line} imports {target}"


@pytest.mark.parametrize("path", ALL_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_stay_readable(path: Path) -> None:
    lines = len(path.read_text(encoding="utf-8").splitlines())
    assert lines <= MAX_LINES, f"{path.relative_to(ROOT)} has {lines} lines: split it"


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_only_configurations_and_the_command_line_know_hydra(module: str) -> None:
    if module.startswith(("warpvox.cli", "warpvox.configs")):
        return
    used = {target.split(".")[0] for _, target in imports(parse(SOURCES[module]))}
    assert "hydra" not in used


@pytest.mark.parametrize(
    "module", sorted(name for name in SOURCES if name.removeprefix("warpvox.").partition(".")[0] in CORE)
)
def test_the_core_imports_nothing_heavy(module: str) -> None:
    used = {target.split(".")[0] for _, target in imports(parse(SOURCES[module]), inside_functions=False)}
    assert not used & HEAVY


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_every_module_says_what_it_is_for(module: str) -> None:
    assert ast.get_docstring(parse(SOURCES[module]))


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_simulations_and_environments_are_used_by_their_doors(module: str) -> None:
    """What begins with an underscore is the affair of the class alone."""
    path, owners = SOURCES[module], {"sim", "env", "vec", "_sim", "_env", "_vec", "simulation", "engine"}
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno} {node.attr}"
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__")
        and getattr(node.value, "attr", getattr(node.value, "id", None)) in owners
        and node.attr != "_engine"  # of EvoGym's EvoSim, which is called sim as well
    ]  # fmt: skip
    assert not found
