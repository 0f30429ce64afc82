"""The house has layers; these tests keep them. See CONTRIBUTING.md for what belongs where."""

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

import api_pages

from warpvox import cli
from warpvox.cli.help import keys_of
from warpvox.configs.schema import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER
}  # fmt: skip
LINKED = ("kernels", "envs", "algos", "configs")

CORE = ("errors", "system", "types", "examples", "io", "design", "world", "contact_order", "compile")
REGISTERING = {"warpvox.envs", "warpvox.evogym.envs"}
"""Modules that are imported to register environments (docs/libraries.md, docs/evogym.md)."""
HEAVY = {"torch", "warp", "hydra", "omegaconf", "rsl_rl", "gymnasium", "matplotlib", "pxr"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] in LINKED:
        parts = ("warpvox", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {module_name(path): path for folder in ("warpvox", *LINKED) for path in sorted((ROOT / folder).rglob("*.py"))}
BESIDE = [path for folder in ("lab", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
ALL_FILES = [*SOURCES.values(), *BESIDE, *sorted((ROOT / "tests").rglob("*.py"))]


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


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def place(path: Path, line: int) -> str:
    return f"{path.relative_to(ROOT)}:{line}"


def test_the_drawing_shows_every_module_and_nothing_else() -> None:
    modules = set(SOURCES) - {"warpvox"}
    missing = sorted(name for name in modules if room(name) is None)
    assert not missing, f"draw these in CONTRIBUTING.md: {missing}"
    assert {room(name) for name in modules} == set(ROOMS), "CONTRIBUTING.md draws what does not exist"
    assert len(set(ROOMS)) == len(ROOMS)


def test_no_layer_imports_a_later_one() -> None:
    wrong = []
    for module in set(SOURCES) - {"warpvox"}:
        for line, target in imports(parse(SOURCES[module])):
            # `import warpvox` loads what lies in any layer: its version is read by what says who made a run
            last = layer(module) if target != "warpvox" else layer(module) - layer("warpvox.runs")
            if target.split(".")[0] == "warpvox" and (layer(target) or 0) > last:
                wrong.append(f"{place(SOURCES[module], line)} imports {target}, which belongs to a later layer")
    assert not wrong, "\n".join(wrong)


def test_no_file_imports_itself_by_way_of_others() -> None:
    graph = {name: {target for _, target in imports(parse(path))} & set(SOURCES) for name, path in SOURCES.items()}
    # The package itself loads its names on demand, and a package's own file may name what is in its folder.
    graph = {name: {t for t in targets if not f"{name}.".startswith(f"{t}.")} for name, targets in graph.items()}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the files


def test_the_library_does_not_speak_shell() -> None:
    command = re.compile(rf"warpvox ({'|'.join(cli.COMMANDS)})\b")
    wrong = []
    for module, path in SOURCES.items():
        # The report is a page for people, with the command that plays a design beside it.
        if module == "warpvox.algos.report" or not module.startswith(
            ("warpvox.algos", "warpvox.envs", "warpvox.kernels")
        ):
            continue
        tree = parse(path)
        for line, target in imports(tree):
            if target.split(".")[0] == "rich":
                wrong.append(f"{place(path, line)} imports rich")
        docstrings = [node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)]
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and node not in docstrings and command.search(str(node.value)):
                wrong.append(f"{place(path, node.lineno)} writes a command to type")
    assert not wrong, "\n".join(wrong)


def test_linked_folders_are_imported_by_their_full_name() -> None:
    # `import kernels.x` works when the root is on sys.path and registers every Warp module twice
    wrong = [
        f"{place(path, line)} imports {target}"
        for path in ALL_FILES
        for line, target in imports(parse(path))
        if target.split(".")[0] in LINKED
    ]
    assert not wrong, "\n".join(wrong)


def test_what_lies_beside_the_house_uses_its_public_names_only() -> None:
    """Those of ``warpvox/__init__.pyi``, of the pages of the Python interface, and the drop-in."""
    documented = api_pages.documented_names() | REGISTERING | {"warpvox", "warpvox.__version__"}
    wrong = []
    for path in BESIDE:
        for node in ast.walk(parse(path)):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module != "warpvox.evogym":
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "wv":
                names = [f"warpvox.{node.attr}"]
            for name in names:
                if name.split(".")[0] == "warpvox" and name not in documented:
                    wrong.append(f"{place(path, node.lineno)} uses {name}")
    assert not wrong, "\n".join([*wrong, "what is missing is an extension point: document it (docs/api_pages.py)"])


def users(library: set[str], modules: Iterable[str], **options: bool) -> list[str]:
    """Where modules import one of these libraries."""
    return [
        place(SOURCES[module], line)
        for module in modules
        for line, target in imports(parse(SOURCES[module]), **options)
        if target.split(".")[0] in library
    ]


def test_only_configurations_and_the_command_line_know_hydra() -> None:
    assert not users({"hydra"}, [name for name in SOURCES if not name.startswith(("warpvox.cli", "warpvox.configs"))])


def test_the_core_imports_nothing_heavy() -> None:
    core = [name for name in SOURCES if name.removeprefix("warpvox.").partition(".")[0] in CORE]
    assert len(core) >= len(CORE)
    assert not users(HEAVY, core, inside_functions=False)


def test_every_module_says_what_it_is_for() -> None:
    assert not [name for name, path in SOURCES.items() if not ast.get_docstring(parse(path))]


def first_words(path: Path) -> Iterator[tuple[type, int, str]]:
    """Yield what each docstring of a file documents (a type of :mod:`ast`, or property), its line and first word."""
    for node in ast.walk(parse(path)):
        body = getattr(node, "body", None)
        for owner, statement in pairwise([node, *body] if isinstance(body, list) else []):
            text = getattr(getattr(statement, "value", None), "value", None)
            if isinstance(statement, ast.Expr) and isinstance(text, str):
                decorators = map(ast.dump, getattr(owner, "decorator_list", ()))
                kind = property if any("property" in decorator for decorator in decorators) else type(owner)
                yield kind, statement.lineno, text.split()[0].strip(",.:")


def test_docstrings_of_functions_begin_with_a_verb_and_others_with_a_noun() -> None:
    verb = re.compile(
        r"(?!(An?|Both|By|Each|How|If|It|No|One|So|That|The|Those|Where|Whose|Within)$|(?!Pass|Process).*s$|.*[^e]ed$)[A-Z][a-z]+"
    )
    noun = re.compile(r"(?!(Called|Get|Held|How|Keep|Of|Return|So|What|[a-z]+s)$).*")
    wrong = []
    for path in [*SOURCES.values(), *BESIDE, *(ROOT / "tests" / "helpers").glob("*.py")]:
        for kind, line, word in first_words(path) if not path.name.startswith("test_") else ():
            expected = verb if kind in (ast.FunctionDef, ast.AsyncFunctionDef) else noun
            wrong += [] if expected.fullmatch(word) else [f"{place(path, line)} begins with {word}"]
    assert not wrong, "\n".join(wrong)


def test_sentences_of_help_are_short() -> None:
    texts = [*cli.COMMANDS.values(), *(key.help for command in COMMANDS for key in keys_of(command).values())]
    long = [sentence for text in texts for sentence in re.split("[.;:] ", text) if len(sentence.split()) > 25]
    assert not long, "\n".join(long)


def test_simulations_and_environments_are_used_by_their_public_methods() -> None:
    owners = {"sim", "env", "vec", "_sim", "_env", "_vec", "simulation", "engine"}
    found = [
        f"{place(path, node.lineno)} {node.attr}"
        for path in SOURCES.values()
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__")
        and getattr(node.value, "attr", getattr(node.value, "id", None)) in owners
        and node.attr != "_engine"  # of EvoGym's EvoSim, which is called sim as well
    ]  # fmt: skip
    assert not found, "\n".join(found)


CEILINGS = {
    "tokens": 267_990,  # PPO and resets in few launches on CUDA, old names of keys in files, tables of groups
    "tokens a line of code": 10.65,
    "names at module level": 1_672,
    "public names at module level": 1_258,
    "files that train may load": 152,  # the PPO of populations learns for train on CUDA
    "files in circles, types counted": 0,
    "lines of tests": 26_718,
    "patterns of sentences in tests": 36,
}
"""How large the house may be. Lower a figure when a change has brought it down; a higher one needs a reason."""


def code_tokens(path: Path) -> Iterator[tokenize.TokenInfo]:
    """Yield the tokens of a file that are neither comments, docstrings nor line ends."""
    docstrings = set()
    for node in ast.walk(parse(path)):
        for statement in getattr(node, "body", None) if isinstance(getattr(node, "body", None), list) else ():
            value = getattr(statement, "value", None)
            if isinstance(statement, ast.Expr) and isinstance(value, ast.Constant) and isinstance(value.value, str):
                docstrings |= set(range(statement.lineno, statement.end_lineno + 1))
    for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
        if token.type not in NO_CODE and token.start[0] not in docstrings:
            yield token


def module_level_names(path: Path) -> Iterator[str]:
    """Yield the functions, classes and constants of a file."""
    for node in parse(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name))


def imported(types: bool) -> dict[str, set[str]]:
    """The modules that each module imports, those that only type checkers need among them if ``types``."""
    graph: dict[str, set[str]] = {}
    for module, path in SOURCES.items():
        targets = {target for _, target in imports(parse(path))}
        if types:
            guarded = [node for node in ast.walk(parse(path)) if for_type_checkers_only(node)]
            targets |= {
                target for node in guarded for part in node.body for _, target in imports(ast.Module([part], []))
            }
        graph[module] = (targets & set(SOURCES)) - {module}
    return graph


def reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    """The modules that ``start`` leads to; it is one of them if it lies in a circle."""
    found: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            waiting += graph[module]
    return found


def test_the_house_grows_no_larger() -> None:
    tokens = lines = 0
    names = []
    for path in SOURCES.values():
        found = list(code_tokens(path))
        tokens += len(found)
        lines += len({line for token in found for line in range(token.start[0], token.end[0] + 1)})
        names += module_level_names(path)
    with_types = imported(types=True)
    with_packages = {
        module: targets | {name for name in SOURCES if any(t.startswith(f"{name}.") for t in (module, *targets))}
        for module, targets in imported(types=False).items()
    }
    tests = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py")]
    measured = {
        "tokens": tokens,
        "tokens a line of code": tokens / lines,
        "names at module level": len(names),
        "public names at module level": sum(not name.startswith("_") for name in names),
        "files that train may load": len(reachable(with_packages, "warpvox.cli.commands.train")),
        "files in circles, types counted": sum(module in reachable(with_types, module) for module in with_types),
        "lines of tests": sum(text.count("\n") for text in tests),
        "patterns of sentences in tests": sum(text.count("match=") for text in tests),
    }
    assert not {name: value for name, value in measured.items() if value > CEILINGS[name]}, measured
