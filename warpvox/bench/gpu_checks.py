"""The checks of ``warpvox bench suite=gpu``: the device computes what the CPU computes, and always the same."""

import math
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
import warp as wp

from warpvox.bench import cases
from warpvox.bench.report import Report, number
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import SimulationError

STEPS, ENVS, FEW, MOST = 30, 32, 3, 4096
"""Control steps; environments of a comparison with the CPU, of a small batch; environments of different actions."""
SHARE, SENSED = 0.9, 0.75
"""Share of the control steps of all environments that must keep to the tolerances: in a few of them rounding decides
otherwise about a contact, in some tasks in all environments at once. Of the entries of a term of the observation fewer:
points of a body at rest lie above the very edges at which the terrain's height jumps."""
TOLERANCES = {
    "float32": {"pos": 2e-8, "vel": 1e-5, "obs": 2e-3, "reward": 1e-6},
    "float64": {"pos": 1e-12, "vel": 1e-9, "obs": 1e-9, "reward": 1e-9},
}
"""Largest differences between device and CPU after one control step from the same state, in simulator units: some
times what float32 differs from float64 by on the CPU (4e-9 and 6e-7 for positions and velocities). Observations show
whether sensing is right, term by term; an angle near 0 has half of the digits."""
TEST_SECONDS = 240
QUERY = "nvidia-smi", "--query-gpu=name,driver_version,clocks.max.sm,power.limit", "--format=csv,noheader"


def smoke(config: Any, report: Report) -> dict[str, Any]:
    """The driver's report, and a few control steps with Warp's own check of every launch."""
    asked = subprocess.run(QUERY, capture_output=True, text=True) if shutil.which(QUERY[0]) else None
    driver = asked.stdout.strip() if asked else None
    before, wp.config.verify_cuda = wp.config.verify_cuda, True
    try:
        env = _make(config, 2 * ENVS)
        env.reset(env.seed)
        for _ in range(FEW):
            obs, *_ = env.step(torch.ones((env.num_envs, env.num_actions), dtype=env.dtype, device=env.device))
    finally:
        wp.config.verify_cuda = before
    if not bool(torch.isfinite(obs).all()):
        raise SimulationError("The observations after three control steps are not finite.")
    report.note(f"{driver or config.device}: {FEW} control steps, layout {env.sim.layout}.")
    return {"driver": driver, "layout": env.sim.layout}


def correctness(config: Any, report: Report, part: str, tasks: list[str], dtype: str) -> None:
    """Tasks in one precision: each control step of the device against the CPU in float64, from the CPU's state."""
    wrong: list[str] = []
    for task in report.in_time(part, tasks):
        exact = _make(config, ENVS, task=task, dtype="float64", device="cpu", lanes=1)
        apart = _apart(exact, _make(config, ENVS, task=task, dtype=dtype))
        row = {name: float(values.quantile(SHARE)) for name, values in apart.items()}
        terms = [place for place in exact.obs_columns[0].values() if place.stop > place.start]
        row["obs"] = max(float(apart["obs"][..., place].quantile(SENSED)) for place in terms)
        good = all(row[name] <= allowed for name, allowed in TOLERANCES[dtype].items())  # NaN is not
        wrong += [] if good else [f"{task} by {row['pos']:.1e}"]
        beyond = float((apart["pos"] > TOLERANCES[dtype]["pos"]).double().mean())
        text = f"{task}, {dtype}: " + ", ".join(f"{name} within {number(value)}" for name, value in row.items())
        text += f", {beyond:.2%} beyond" if beyond else ""
        values: dict[str, Any] = {"task": task, "dtype": dtype, "good": good, "beyond": beyond, **row}
        report.row(part, f"{text}{'' if good else ' WRONG'}", **values)
    if wrong:
        raise SimulationError(f"The device differs from the CPU in {', '.join(wrong[:6])}.")
    report.note(
        f"{dtype}, {len(report.figures.get(part, []))} tasks: {SHARE:.0%} of the control steps are within the"
        " tolerances of the CPU in float64."
    )


def _apart(exact: VoxelVecEnv, env: VoxelVecEnv) -> dict[str, torch.Tensor]:
    """Differences after one control step from the state of ``exact``, which goes on: ``[STEPS, num_envs]`` each, of
    observations ``[STEPS, num_envs, num_obs]``."""
    found: dict[str, list[torch.Tensor]] = {name: [] for name in TOLERANCES["float64"]}
    exact.reset(exact.seed)
    for actions in _actions(exact):
        env.set_state(exact.state())
        results = []
        for one in (exact, env):
            obs, reward, *_ = one.step(actions.to(one.device, one.dtype))
            state = one.sim.state()
            results.append({"pos": state["pos"], "vel": state["vel"], "obs": obs, "reward": reward[:, None]})
        for name, values in found.items():
            mine, theirs = (result[name].double().cpu() for result in results)
            apart = (mine - theirs).abs().flatten(1)
            # an angle just below 2 pi is near 0
            values.append(torch.minimum(apart, (apart - 2 * math.pi).abs()) if name == "obs" else apart.amax(1))
    return {name: torch.stack(values) for name, values in found.items()}


def determinism(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """Two runs are equal bit for bit: centres, rewards, observations, state."""
    env = _make(config, envs)
    said = f"Two runs of {envs:,} environments over {STEPS} control steps are equal bit for bit."
    return _compare(report, _outcomes(env), _outcomes(env), said)


def independence(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """The first environments of a large batch do what they do in a small one, bit for bit."""
    large, small = _outcomes(_make(config, max(envs, ENVS))), _outcomes(_make(config, FEW))
    said = f"Environments do the same in batches of {FEW} and of {len(large['reward']):,}, bit for bit."
    return _compare(report, large, small, said)


def graph(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """Control steps launched as one graph are those launched one by one, bit for bit, past ends of episodes."""
    options: dict[str, Any] = dict(auto_reset=True, max_episode_steps=STEPS // 2)
    with_graph, without = (_outcomes(_make(config, envs, cuda_graph=wanted, **options)) for wanted in (True, False))
    said = f"{envs:,} environments over {STEPS} control steps are equal with and without a graph, bit for bit."
    return _compare(report, with_graph, without, said)


def stream(config: Any, report: Report, envs: int) -> dict[str, Any]:
    """On a stream of one's own control steps are those on torch's first one, bit for bit."""
    env = _make(config, envs)
    expected = _outcomes(env)
    torch.cuda.synchronize(config.device)
    said = f"{envs:,} environments over {STEPS} control steps are equal on another stream, bit for bit."
    with torch.cuda.stream(torch.cuda.Stream(config.device)):
        return _compare(report, _outcomes(env), expected, said)


def _make(config: Any, envs: int, task: str | None = None, **options: Any) -> VoxelVecEnv:
    lanes = 8 if config.device == "cpu" else None
    given = dict(arithmetic=None, seed=config.seed, auto_reset=False, lanes=lanes) | options
    return cases.make(config, [cases.one_body(config)], envs, task, **given)


def _outcomes(env: VoxelVecEnv) -> dict[str, torch.Tensor]:
    """On the CPU, of STEPS control steps from a reset on, environments first.

    Centres of mass and rewards of every step, the last observations and the state.
    """
    centres, rewards = [], []
    env.reset(env.seed)
    for actions in _actions(env):
        obs, reward, *_ = env.step(actions.to(env.device, env.dtype))
        rewards.append(reward.cpu())
        centres.append(env.sim.com("robot").cpu())
    state = {name: value.cpu() for name, value in env.sim.state().items()}
    return {"centre": torch.stack(centres, 1), "reward": torch.stack(rewards, 1), "obs": obs.cpu(), **state}


def _actions(env: VoxelVecEnv) -> Iterator[torch.Tensor]:
    """Random actions of STEPS control steps: the same on every device and for the first environments of any number.

    Whole multiples of 1 / 1024, exact in both precisions.
    """
    random, rows = torch.Generator().manual_seed(0), torch.arange(env.num_envs) % MOST
    for _ in range(STEPS):
        yield (torch.randint(615, 1639, (env.num_actions, MOST), generator=random).T / 1024)[rows]


def _compare(
    report: Report, found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor], said: str
) -> dict[str, Any]:
    """Note that the first environments of ``found`` are those expected; SimulationError: they are not."""
    wrong = [name for name, value in expected.items() if not torch.equal(found[name][: len(value)], value)]
    if wrong:
        raise SimulationError(f"They differ in {', '.join(wrong)}; expected: {said}")
    report.note(said)
    return {"num_envs": len(found["reward"]), "steps": STEPS}


def recordings(config: Any, report: Report) -> dict[str, Any]:
    """The tests marked ``gpu``, recordings of the reference among them, where this is a checkout with pytest."""
    tests = Path(__file__).resolve().parents[2] / "tests"
    if config.device == "cpu" or not (tests / "parity").is_dir() or find_spec("pytest") is None:
        reason = "tests of the GPU need one" if config.device == "cpu" else "this is no checkout with pytest"
        report.note(f"Recordings of the reference were not replayed: {reason}.")
        return {"replayed": False, "reason": reason}
    words = [sys.executable, "-m", "pytest", "-q", "-m", "gpu", "-p", "no:cacheprovider", str(tests)]
    words += ["-n", "4"] if find_spec("xdist") else []
    limit = max(1.0, min(TEST_SECONDS, report.left))
    try:
        done = subprocess.run(words, cwd=tests.parent, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        report.note(f"Tests of the GPU were stopped after {limit:.0f} s.")
        return {"replayed": False, "reason": f"stopped after {limit:.0f} s"}
    last = (done.stdout.strip().splitlines() or [""])[-1]
    report.note(f"Tests of the GPU: {last}")
    if done.returncode:
        raise SimulationError(f"Tests of the GPU failed: {last}\n{done.stdout[-6000:]}")
    return {"replayed": True, "result": last}
