"""``warpvox bench suite=gradients``: derivatives of control steps: their error, their time, gaits found with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from warpvox.bench.cases import make, sampled_bodies
from warpvox.bench.report import Report, middle
from warpvox.bench.runner import seconds
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import SimulationError
from warpvox.gradients import SMOOTHING, Gradients
from warpvox.types import VOXEL, Cell

SIDE, BODIES = 5, 32
"""Cells of a side, and number, of the random bodies."""
STEPS, ITERATIONS = 120, 40
"""Control steps whose displacement counts, and steps of Adam."""
SMOOTHINGS = 1e-6, 1e-4, 4e-4, 8e-4, 1.6e-3, 6.4e-3
"""Smoothing of contacts with terrain, in simulator units."""
ROBOT = "robot"
ALLOWED = 0.1
"""Relative error of a derivative by the actions in the air beyond which no time is reported."""
LIFT = 3.0
"""Height of the check above the ground, in simulator units."""
PERIOD = 10
"""Control steps after which a gait repeats."""
MIDDLE, SWING = 1.1, 0.5
"""Actions are MIDDLE + SWING tanh(table)."""
RATE, BETAS = 0.1, (0.8, 0.95)
"""Adam's rate and betas, on the tables."""
COST = 5
"""Random waves are tried so many times as often as gradients: about what the reverse pass costs."""
TIMED = 20
"""Control steps of a timed repetition."""


def run(config: Any, report: Report) -> None:
    """The error of derivatives in the air, the time of a step with them, and displacements of gaits."""
    bodies = sampled_bodies(SIDE, BODIES, config.seed)
    with report.console.status("checking"):
        error = _error(config, bodies)
    if not error < ALLOWED:
        raise SimulationError(f"Derivatives by actions differ by {error:.1%} from finite differences.")
    report.note(f"Checked: derivatives by actions in the air, within {error:.2%} of finite differences in float64.")
    with report.console.status("measuring"):
        rates = _times(config, bodies)
    plain, *_ = map(middle, rates.values())
    title = f"{config.task}, {len(bodies)} different bodies {SIDE}x{SIDE}, microseconds a control step"
    rows = [[name, times, middle(times) / plain] for name, times in rates.items()]
    report.table(title, ["", "time", "ratio"], rows)
    with report.console.status("making gaits"):
        gaits = {smoothing: _gaits(config, bodies, ITERATIONS, smoothing) for smoothing in SMOOTHINGS}
        waves = _gaits(config, bodies, COST * ITERATIONS)
    shown = [[f"gradients, smoothing {smoothing:g}", *row] for smoothing, row in gaits.items()]
    shown.append([f"best of {COST * ITERATIONS} random waves", *waves])
    title = f"Gaits of {PERIOD} steps, voxels in {STEPS} steps after {ITERATIONS} iterations"
    report.table(title, ["", "mean", "worst tenth", "best tenth"], shown)
    report.figures["error"] = error


def _make(config: Any, bodies: list[np.ndarray], **options: Any) -> VoxelVecEnv:
    return make(config, bodies, len(bodies), arithmetic="fast", layout="lanes", auto_reset=False, **options)


def _noise(shape: torch.Size, seed: int, device: str) -> torch.Tensor:
    return torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)).to(device)


def _error(config: Any, bodies: list[np.ndarray]) -> float:
    """Relative error of the derivative of positions after a control step by the actions, along random directions."""
    env = _make(config, bodies, dtype="float64", lanes=8)
    gradients, sim = Gradients(env.sim), env.sim
    env.reset(seed=config.seed)
    state, phase = gradients.state(), _noise(sim.actions.shape, config.seed, sim.device)
    state[:, 0, 1::2] += LIFT * sim.rows[1][:, 1::2]
    for step in range(5):
        state = gradients.step(state, 1 + 0.2 * torch.sin(step / 3 + phase))
    weights, way = _noise(state[:, 0].shape, 1, sim.device) * sim.rows[1], _noise(phase.shape, 2, sim.device)

    def loss(actions: torch.Tensor) -> torch.Tensor:
        return (gradients.step(state, actions)[:, 0] * weights).sum(1)

    actions, step = (1 + 0.2 * torch.sin(2 + phase)).requires_grad_(), 1e-5
    (by_actions,) = torch.autograd.grad(loss(actions).sum(), actions)
    expected = (loss(actions + step * way) - loss(actions - step * way)).detach() / (2 * step)
    return float(((by_actions * way).sum(1) - expected).norm() / expected.norm())


def _times(config: Any, bodies: list[np.ndarray]) -> dict[str, list[float]]:
    """Microseconds of a control step of an environment."""
    env = _make(config, bodies)
    gradients, sim = Gradients(env.sim), env.sim
    env.reset(seed=config.seed)
    start, actions = gradients.state(), 1.1 + 0.4 * torch.sin(_noise(sim.actions.shape, 0, sim.device))

    def plain() -> None:
        for _ in range(TIMED):
            sim.step(actions)

    def roll(acts: torch.Tensor) -> torch.Tensor:
        state = start
        for _ in range(TIMED):
            state = gradients.step(state, acts)
        return gradients.com(state, ROBOT)[:, 0].sum()

    ways = {
        "simulation alone": plain,
        "with a state that torch knows": lambda: roll(actions),
        "with its reverse pass": lambda: roll(actions.clone().requires_grad_()).backward(),
    }
    found: dict[str, list[float]] = {name: [] for name in ways}
    for repeat in range(config.repeats + 1):
        for name, way in ways.items():
            taken = seconds(way, config.device)
            if repeat:
                found[name].append(taken / TIMED / len(bodies) * 1e6)
    return found


def _wave(bodies: list[np.ndarray], num_actions: int, seed: int, device: str) -> torch.Tensor:
    """float64 ``[body, PERIOD, actuator]``: a travelling wave through each body, at random rates along its axes."""
    random, table = np.random.default_rng(seed), np.zeros((len(bodies), PERIOD, num_actions))
    for row, body in zip(table, bodies, strict=True):
        rates, turn = random.uniform(-1.6, 1.6, 2), random.uniform(-np.pi, np.pi)
        cells = np.argwhere((body == Cell.H_ACT) | (body == Cell.V_ACT))
        phase = cells @ rates + turn * (body[tuple(cells.T)] == Cell.V_ACT)
        row[:, : len(cells)] = np.sin(2 * np.pi / PERIOD * np.arange(PERIOD)[:, None] + phase)
    return torch.tensor(table, device=device)


def _gaits(config: Any, bodies: list[np.ndarray], count: int, smoothing: float | None = None) -> list[float]:
    """Mean, lowest and highest tenth of displacements by each body's best of ``count`` tables, in voxels.

    The tables are random waves; with ``smoothing`` those on the way of Adam, which begins with a wave.
    """
    env = _make(config, bodies)
    gradients, sim = Gradients(env.sim, smoothing or SMOOTHING), env.sim
    table = _wave(bodies, sim.num_actions, config.seed, sim.device).requires_grad_(smoothing is not None)
    optimizer = torch.optim.Adam([table], RATE, BETAS)
    best = torch.full((len(bodies),), -torch.inf, dtype=torch.float64, device=sim.device)
    for k in range(count):
        if smoothing is None:
            table = _wave(bodies, sim.num_actions, config.seed + k, sim.device)
        env.reset(seed=config.seed)
        state, actions = gradients.state(), MIDDLE + SWING * torch.tanh(table)
        start = gradients.com(state, ROBOT)[:, 0]
        for step in range(STEPS):
            state = gradients.step(state, actions[:, step % PERIOD])
        gone = gradients.com(state, ROBOT)[:, 0] - start
        best = torch.maximum(best, gone.detach())
        if smoothing is not None:
            (table.grad,) = torch.autograd.grad(-gone.sum(), table)
            torch.nan_to_num_(table.grad, 0.0, 0.0, 0.0)
            optimizer.step()
    voxels = best.cpu().numpy() / VOXEL
    return [float(x) for x in (voxels.mean(), *np.quantile(voxels, [0.1, 0.9]))]
