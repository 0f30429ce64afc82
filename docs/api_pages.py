"""Pages of the Python interface, made while the site is built. Not part of the library.

What is public is read from ``warpvox/__init__.pyi``; mkdocstrings reads the docstrings without importing anything.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

STUB = Path(__file__).resolve().parents[1] / "warpvox" / "__init__.pyi"
TITLES = {
    "api": "Training and policies",
    "envs.vec_env": "Batches of environments",
    "batch.options": "Options of a simulation",
    "envs.registry": "Tasks",
    "envs.design_episodes": "Bodies within episodes",
    "design": "Bodies",
    "world": "Worlds",
    "simulation": "Simulation",
    "gradients": "Gradients",
    "view.rollout": "Rollouts",
    "robots.entry": "Robots of the zoo",
    "code": "Code of one's own",
    "types": "Types",
    "errors": "Errors",
}
"""Modules of public names with the titles of their pages, in order; others come last, under their own names."""
BESIDE = {
    "envs.vec_env": ("envs.vec_env.VoxelVecEnv",),
    "envs.design_episodes": ("envs.design_episodes.DesignVecEnv", "envs.design_episodes.DesignLayout"),
    "envs.registry": (
        *("envs.spec.TaskSpec", "envs.spec.observes", "envs.spec.rewards", "envs.spec.terminates", "envs.spec.Memory"),
        *("envs.about.about", "envs.snapshot.Snapshot", "envs.random_stream.RandomStream", "envs.registry.get_task"),
    ),
    "view.rollout": (
        *("view.rollout.Rollout", "view.render.Film", "view.render.draw_frame", "view.render.write_gif"),
        *("view.render.write_mp4", "view.render.write_png", "view.render.write_filmstrip", "view.player.write_html"),
        "view.usd.write_usd",
    ),
    "robots.entry": (
        *("robots.entry.Robot", "robots.gait.Gait", "robots.network.Network", "robots.replay.judge"),
        *("robots.replay.robot_env", "robots.entry.read_robot", "robots.entry.save_robot"),
    ),
    "design": ("design.full_connections", "design.repair_design"),
    "api": ("algos.checkpoints.policy.Policy",),
}
"""What public functions take and return, shown beside them."""
MORE = {
    "adapters": (
        "Other libraries",
        *(
            "envs.adapters.gym.VoxelEnv",
            "envs.adapters.gym.register_task",
            "envs.adapters.gym_vector.VoxelGymVectorEnv",
        ),
        *("envs.adapters.rsl_rl.RslRlVecEnv", "envs.adapters.sb3.VoxelSB3VecEnv"),
    ),
    "search": ("Searches of one's own", "algos.search.base.BaseSearch", "algos.candidate.Candidate"),
}
"""Pages without a name in ``warpvox`` itself."""
FULL = "::: {}\n    options: {{show_root_full_path: true}}"


@cache
def public_modules() -> dict[str, tuple[str, ...]]:
    """Public names by the module that they come from."""
    found = {}
    for node in ast.parse(STUB.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            found[node.module] = tuple(name.name for name in node.names)
    return found


@cache
def public_names() -> frozenset[str]:
    """All names that ``import warpvox`` offers."""
    return frozenset(name for names in public_modules().values() for name in names)


@cache
def pages() -> dict[str, str]:
    """Place in the site -> Markdown."""
    modules = public_modules()
    ordered = [name for name in TITLES if name in modules] + [name for name in modules if name not in TITLES]
    entries = {
        module: (
            TITLES.get(module, module),
            [f"warpvox.{name}" for name in modules[module]],
            [f"warpvox.{name}" for name in BESIDE.get(module, ())],
        )
        for module in ordered
    }
    for key, (title, *names) in MORE.items():
        entries[key] = (title, [], [f"warpvox.{name}" for name in names])
    made = {"api/index.md": _index(entries)}
    for key, (title, public, beside) in entries.items():
        parts = [f"# {title}", *(f"::: {name}" for name in public), *(FULL.format(name) for name in beside)]
        made[f"api/{key.replace('.', '_')}.md"] = "\n\n".join(parts)
    return made


def _index(entries: dict[str, tuple[str, list[str], list[str]]]) -> str:
    rows = [
        f"| [{title}]({key.replace('.', '_')}.md) | {', '.join(_link(name) for name in public + beside)} |"
        for key, (title, public, beside) in entries.items()
    ]
    head = (
        "# Python\n\n`import warpvox as wv` takes less than a second and offers what stands here as `wv.NAME`; other"
        " names are imported from the module that their page shows.\n\n| | |\n|---|---|"
    )
    return "\n".join([head, *rows, ""])


def _link(name: str) -> str:
    short = name.rpartition(".")[2]
    return f"[`{'wv.' * (name.count('.') == 1)}{short}`][{name}]"
