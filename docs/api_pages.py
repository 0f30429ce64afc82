"""Pages of the Python interface, made while the site is built. Not part of the library.

What is public is read from ``warpvox/__init__.pyi``; mkdocstrings reads the docstrings without importing anything.
"""

import ast
import re
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "warpvox"
STUB = PACKAGE / "__init__.pyi"
TITLES = {
    "api": "Training and policies",
    "algos.training.loading": "Training and policies",
    "algos.training.settings": "Training and policies",
    "algos.settings": "Training and policies",
    "design_search": "Design search",
    "algos.codesign.settings": "Design search",
    "algos.codesign.results": "Design search",
    "algos.codesign.fitness": "Design search",
    "algos.search.settings": "Design search",
    "envs.vec_env": "Batches of environments",
    "batch.options": "Options of a simulation",
    "envs.registry": "Tasks",
    "design": "Bodies",
    "world": "Worlds",
    "simulation": "Simulation",
    "gradients": "Gradients",
    "view.body_picture": "Bodies",
    "view.rollout": "Rollouts",
    "algos.robots.entry": "Robots of the zoo",
    "code": "Code of one's own",
    "types": "Types",
    "errors": "Errors",
}
"""Modules of public names with the titles of their pages, in order; others come last, under their own names."""
BESIDE = {
    "Training and policies": (
        *("algos.checkpoints.policy.Policy", "algos.policies.model.VoxelModel", "algos.policies.layout.layout_of"),
        "algos.policies.transformer.AttentionBlock",
    ),
    "Batches of environments": ("envs.vec_env.VoxelVecEnv",),
    "Tasks": (
        *("envs.spec.TaskSpec", "envs.spec.observes", "envs.spec.rewards", "envs.spec.terminates", "envs.spec.Memory"),
        *("envs.about.about", "envs.snapshot.Snapshot", "envs.random_stream.RandomStream", "envs.registry.get_task"),
        *("envs.registry.known_returns", "envs.registry.KnownReturn"),
    ),
    "Rollouts": (
        *("view.rollout.Rollout", "view.render.Film", "view.render.draw_frame", "view.render.write_gif"),
        *("view.render.write_mp4", "view.render.write_png", "view.render.write_filmstrip", "view.player.write_html"),
        "view.usd.write_usd",
    ),
    "Robots of the zoo": (
        *("algos.robots.entry.Robot", "algos.robots.policies.gait_policy", "algos.robots.policies.network_policy"),
        *("algos.robots.episodes.judge", "algos.robots.episodes.robot_env"),
        *("algos.robots.entry.read_robot", "algos.robots.entry.save_robot"),
        "algos.codesign.robots.robots_of",
    ),
    "Bodies": ("design.full_connections", "design.repair_design"),
    "Other libraries": (
        *("envs.adapters.gym.VoxelEnv", "envs.adapters.gym.register_task"),
        *("envs.adapters.gym_vector.VoxelGymVectorEnv", "envs.adapters.rsl_rl.RslRlVecEnv"),
        "envs.adapters.sb3.VoxelSB3VecEnv",
    ),
    "Design search": (
        *("configs.composition.settings_named", "algos.report.members.read_members"),
        *("algos.report.members.SearchResult", "algos.archive.Archive", "algos.archive.Record"),
        *("algos.archive.Finished", "algos.codesign.results.FoundDesign"),
    ),
    "Searches of one's own": ("algos.search.base.BaseSearch", "algos.candidate.Candidate", "algos.candidate.Outcome"),
}
"""Types that public functions take and return without a name in ``warpvox`` itself, by the title of the page."""


@cache
def public_modules(stub: Path = STUB) -> dict[str, tuple[str, ...]]:
    """Public names of a package, by the module that they come from."""
    found = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            found[node.module] = tuple(name.name for name in node.names)
    return found


def documented_names() -> set[str]:
    """All names of these pages by their modules, ``warpvox.world.World``, and public ones also as ``warpvox.World``."""
    names = {f"warpvox.{name}" for beside in BESIDE.values() for name in beside}
    for module, public in public_modules().items():
        names |= {f"warpvox.{name}" for name in public} | {f"warpvox.{module}.{name}" for name in public}
    for public in public_modules(PACKAGE / "algos" / "robots" / "__init__.pyi").values():
        names |= {f"warpvox.algos.robots.{name}" for name in public}
    return names


@cache
def pages() -> dict[str, str]:
    """Place in the site -> Markdown."""
    modules = public_modules()
    entries: dict[str, tuple[list[str], list[str]]] = {}
    for module in sorted(modules, key=lambda name: (*TITLES, *modules).index(name)):
        public, _ = entries.setdefault(TITLES.get(module, module), ([], []))
        public += [f"warpvox.{name}" for name in modules[module]]
    for title, names in BESIDE.items():
        entries.setdefault(title, ([], []))[1].extend(f"warpvox.{name}" for name in names)
    made = {"api/index.md": _index(entries)}
    for title, (public, beside) in entries.items():
        made[f"api/{_file(title)}"] = "\n\n".join([f"# {title}", *(f"::: {name}" for name in public + beside)])
    return made


def _file(title: str) -> str:
    return re.sub(r"\W+", "_", title.lower()) + ".md"


def _index(entries: dict[str, tuple[list[str], list[str]]]) -> str:
    rows = [
        f"| [{title}]({_file(title)}) | {', '.join(_link(name) for name in public + beside)} |"
        for title, (public, beside) in entries.items()
    ]
    head = (
        "# Python\n\n`import warpvox as wv` takes less than a second and offers what stands here as `wv.NAME`; other"
        " names are imported from the module that their page shows.\n\n| page | names |\n|---|---|"
    )
    return "\n".join([head, *rows, ""])


def _link(name: str) -> str:
    short = name.rpartition(".")[2]
    return f"[`{'wv.' * (name.count('.') == 1)}{short}`][{name}]"
