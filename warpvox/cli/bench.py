"""``warpvox bench``: speed, with the physics checked before a time is printed."""

from __future__ import annotations

import contextlib
import json
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from warpvox import __version__
from warpvox.cli.config import expand, load, read_arguments, to_yaml
from warpvox.cli.info import cpu_name
from warpvox.cli.precision import precision_suite
from warpvox.cli.runs import check_name, new_folder, write_summary
from warpvox.cli.say import say
from warpvox.cli.train import describe
from warpvox.errors import ConfigError, SimulationError

__all__ = ["run"]

CHECK_STEPS = 60
TOLERANCE = 1e-6
"""Largest difference of the centre of mass over CHECK_STEPS in float64, in simulator units: over so many
steps the two differ by round-off only, which contacts have not yet amplified beyond this."""
HOW_TO_GET_IT = "python3.10 -m venv ref && ref/bin/pip install evogym==2.0.0, then peer.python=ref/bin/python"


def run(words: list[str]) -> None:
    """Do what ``warpvox bench`` is asked for."""
    arguments = read_arguments(words)
    if describe("bench", arguments):
        return
    console = Console()
    for overrides in expand(arguments, "bench"):
        config = load("bench", overrides, arguments.config_dir)
        check_name(config.name)
        with console.status("preparing"):
            from warpvox.cli.build import prepare

            prepare(config.torch_threads, config.seed)
        result = {"peer": peer_suite, "step": step_suite, "precision": precision_suite}[config.suite](config, console)
        facts = {"suite": config.suite, "task": config.task, "version": __version__, "cpu": cpu_name()}
        with new_folder(config.output_dir, "bench", config.task, config.name, to_yaml(config)) as folder:
            write_summary(folder, facts | result)
            say(console, f"figures: {folder / 'summary.json'}")


# -------------------------------------------------------------------------------------------------- suites


def peer_suite(config: Any, console: Console) -> dict[str, Any]:
    """Ours and the reference in turns on the same bodies, tasks and kind of actions.

    Raises:
        ConfigError: no reference. SimulationError: ours and the reference differ.
    """
    from warpvox.envs.registry import released_id

    body, env = _environment(config)
    rng = np.random.default_rng(config.seed)
    with Peer(config.peer.python) as peer:
        with console.status("starting the reference"):
            versions = peer.ask(do="start", task=released_id(config.task), body=body.tolist())
        with console.status("checking the physics"):
            error = _check_physics(config, body, peer)
        say(
            console,
            f"physics: within {error:.1e} of the reference over {CHECK_STEPS} steps in float64",
        )
        ours, theirs = [], []
        with console.status("measuring"):
            _steps(env, config, rng)  # loads the kernels
            for _ in range(config.repeats):
                ours.append(_rate(lambda: _steps(env, config, rng), config))
                actions = rng.uniform(0.6, 1.6, (config.peer.steps, env.num_actions))
                theirs.append(config.peer.steps / peer.ask(do="time", actions=actions.tolist())["seconds"])
    ratio = statistics.median(ours) / statistics.median(theirs)
    name = f"warpvox, {config.num_envs} environments, {config.dtype}, {env.device}"
    rows = {name: ours, f"evogym {versions['evogym']}, Python {versions['python']}": theirs}
    _print_rates(console, f"{config.task}: control steps per second of a core", rows)
    say(console, f"ratio of the medians: {ratio:.1f}")
    return {"check_error": error, "ours": ours, "reference": theirs, "ratio": ratio, "versions": versions}


def step_suite(config: Any, console: Console) -> dict[str, Any]:
    """Ours alone: the bare simulation, with observations and rewards, with a policy, with learning."""
    _, env = _environment(config)
    rng = np.random.default_rng(config.seed)
    parts = {
        "simulation only": lambda: _simulate(env, config, rng),
        "environment": lambda: _steps(env, config, rng),
    }
    parts |= _learning_parts(env, config)
    rates: dict[str, list[float]] = {name: [] for name in parts}
    with console.status("measuring"):
        for part in parts.values():
            part()
        for _ in range(config.repeats):
            for name, part in parts.items():
                rates[name].append(_rate(part, config))
    if not bool(np.isfinite(env.sim.object_positions("robot").cpu().numpy()).all()):
        raise SimulationError("The simulation has left the finite numbers: its speed means nothing.")
    unit = "second" if config.device.startswith("cuda") else "second of CPU time"
    where = f"{config.task}, {config.num_envs} environments, {config.dtype}, {env.device}"
    title = f"{where}: control steps per {unit}"
    _print_rates(console, title, rates)
    return {"rates": rates}


def _environment(config: Any) -> tuple[np.ndarray, Any]:
    from warpvox.cli.build import load_bodies
    from warpvox.envs.vec_env import make_vec

    bodies = load_bodies(config.design, config.seed)
    if len(bodies) > 1:
        raise ConfigError(f"bench measures one body at a time, got {len(bodies)}.")
    env = make_vec(
        config.task, bodies, config.num_envs, device=config.device, dtype=config.dtype, threads=config.threads
    )
    return bodies[0], env


def _check_physics(config: Any, body: np.ndarray, peer: Peer) -> float:
    """The largest difference of the centre of mass; raises SimulationError if it is too large."""
    from warpvox.envs.vec_env import make_vec

    env = make_vec(config.task, [body], 1, device=config.device, dtype="float64", auto_reset=False, threads=1)
    env.reset()
    phase = np.random.default_rng(config.seed).uniform(0, 2 * np.pi, env.num_actions)
    actions = 1.1 + 0.45 * np.sin(2 * np.pi * np.arange(CHECK_STEPS)[:, None] / 25 + phase)
    ours = []
    for action in actions:
        env.step(action[None])
        ours.append(env.sim.com("robot")[0].tolist())
    theirs = peer.ask(do="check", actions=actions.tolist())["com"]
    error = float(np.abs(np.array(ours) - np.array(theirs)).max())
    if not error < TOLERANCE:
        raise SimulationError(
            f"The centre of mass differs from the reference by {error:.1e} within {CHECK_STEPS} steps"
            f" (allowed: {TOLERANCE:.0e}): no speed is worth printing."
        )
    return error


def _learning_parts(env: Any, config: Any) -> dict[str, Callable[[], int]]:
    """Two more parts: steps with actions of a policy, and whole iterations of training."""
    from warpvox.algos.runner import Runner, Schedule, adapt

    ppo = load("train", []).ppo
    runner = Runner(adapt(env, ppo), ppo, Schedule(total=10**6, evaluate=10**6))
    policy = runner.controller

    def infer() -> int:
        obs, _ = env.reset()
        for _ in range(config.steps):
            obs = env.step(policy(obs))[0]
        return config.steps * config.num_envs

    def learn() -> int:
        runner.learn(1)
        return ppo.steps * config.num_envs

    return {"with a policy": infer, "with training": learn}


def _simulate(env: Any, config: Any, rng: np.random.Generator) -> int:
    import torch

    env.sim.reset()
    actions = torch.as_tensor(rng.uniform(0.6, 1.6, (env.num_envs, env.num_actions)), device=env.device)
    for _ in range(config.steps):
        env.sim.step(actions)
    return config.steps * config.num_envs


def _steps(env: Any, config: Any, rng: np.random.Generator) -> int:
    """Control steps with random actions from the beginning of an episode; returns how many."""
    import torch

    env.reset()
    shape = (config.steps, env.num_envs, env.num_actions)
    actions = torch.as_tensor(rng.uniform(0.6, 1.6, shape), dtype=env.dtype, device=env.device)
    for action in actions:
        env.step(action)
    return config.steps * config.num_envs


def _rate(part: Callable[[], int], config: Any) -> float:
    """Control steps per second: of CPU time on the CPU, of the clock elsewhere."""
    if not config.device.startswith("cpu"):
        import torch

        torch.cuda.synchronize()
        began = time.perf_counter()
        steps = part()
        torch.cuda.synchronize()
        return steps / (time.perf_counter() - began)
    began = time.process_time()
    steps = part()
    return steps / (time.process_time() - began)


def _print_rates(console: Console, title: str, rows: dict[str, list[float]]) -> None:
    table = Table(title=title)
    table.add_column("")
    for heading in ("median", "least", "most"):
        table.add_column(heading, justify="right")
    for name, rates in rows.items():
        table.add_row(name, *(f"{value:,.0f}" for value in (statistics.median(rates), min(rates), max(rates))))
    console.print(table)


# ----------------------------------------------------------------------------------------- the other side


class Peer:
    """The reference in a process of its own.

    Raises:
        ConfigError: no interpreter is named, or it cannot run evogym.
    """

    def __init__(self, python: str | None) -> None:
        if not python:
            raise ConfigError(f"The reference is missing. Make it: {HOW_TO_GET_IT}")
        if not Path(python).expanduser().is_file():
            raise ConfigError(f"peer.python={python} is no file. Make the reference: {HOW_TO_GET_IT}")
        script = Path(__file__).with_name("peer.py")
        try:
            # isolated, so that neither this folder nor PYTHONPATH can shadow what the reference imports
            self._process = subprocess.Popen(
                [str(Path(python).expanduser()), "-I", str(script)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except OSError as error:
            raise ConfigError(f"peer.python={python} cannot be run: {error.strerror}.") from None

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def ask(self, **request: Any) -> dict[str, Any]:
        """Send a request and return its answer.

        Raises:
            ConfigError: the reference has failed.
        """
        line = ""
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            pass
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            answer = {"error": f"it ended without an answer to '{request['do']}'"}
        if "error" in answer:
            reason = str(answer["error"]).splitlines()[0]
            raise ConfigError(f"The reference failed ({reason}). A fresh one: {HOW_TO_GET_IT}")
        return answer
