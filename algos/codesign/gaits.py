"""Open-loop gaits, and their random sampling and mutation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpvox.design import Design
from warpvox.types import Cell

_PERIODS = (5.0, 40.0)
"""Shortest and longest period of a random travelling wave, in control steps."""
SHORTEST, LONGEST = 3.0, 400.0
"""Limits of mutated periods in control steps."""


@dataclass(frozen=True, eq=False)
class Gait:
    """An open-loop gait for bodies in a grid: in each stage, a sinusoid for each cell.

    In control step t, of stage s, the action of an actuator in cell c is
    ``1.1 + 0.5 * clip(rest[s, c] + amplitude[s, c] * sin(2 pi t / period[s] + phase[s, c]), -1, 1)``.
    Cells without an actuator have values, too: a mutant of the body may have one there. All values are numbers of
    float32, so that no file format changes them.

    Attributes:
        begin: control step in which each stage begins, float64 ``[stages]``; the first is 0.
        period: control steps, float64 ``[stages]``.
        amplitude, phase, rest: float64 ``[stages, rows, columns]``; phases in radians.
    """

    begin: np.ndarray
    period: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    rest: np.ndarray

    def __post_init__(self) -> None:
        """Round all values to float32, stored as float64."""
        for name, values in vars(self).items():
            object.__setattr__(self, name, values.astype(np.float32).astype(np.float64))


Motion = tuple[float, np.ndarray, np.ndarray, np.ndarray]
"""Motion of one stage: period, amplitude, phase and rest position."""


def motions_of(gait: Gait) -> tuple[tuple[int, Motion], ...]:
    """Split a gait into its motions, each with the control step at which it begins."""
    found = []
    for stage, begin in enumerate(map(int, gait.begin)):
        is_last = stage == len(gait.begin) - 1
        # Skip a stage that has no control step, because the next one begins at the same one.
        if is_last or int(gait.begin[stage + 1]) > begin:
            motion = (gait.period.tolist()[stage], gait.amplitude[stage], gait.phase[stage], gait.rest[stage])
            found.append((begin, motion))
    return tuple(found)


def gait_of(motions: Sequence[tuple[int, Motion]]) -> Gait:
    """Join motions to a gait; the inverse of :func:`motions_of`."""
    begins = [begin for begin, _ in motions]
    periods, amplitudes, phases, rests = zip(*(motion for _, motion in motions), strict=True)
    return Gait(np.array(begins), np.array(periods), np.array(amplitudes), np.array(phases), np.array(rests))


def draw_gait(rng: np.random.Generator, body: Design, steps: int, stages: int) -> Gait:
    """Sample a random gait: a wave or a pose in each stage, or one motion for the whole episode.

    Stages are short at the beginning of the episode as often as at its end, which alone counts in some tasks.
    """
    # Motions
    motions = [draw_motion(rng, body) for _ in range(stages)]
    if rng.random() < 0.5:
        motions = motions[:1] * stages

    # When they begin
    begin = np.exp(rng.uniform(np.log(3.0), np.log(max(steps, 4)), stages)).round()
    begin = np.sort(begin if rng.random() < 0.5 else np.maximum(steps - begin, 0.0))
    begin[0] = 0.0
    return gait_of(list(zip(begin, motions, strict=True)))


def with_stages(gait: Gait, stages: int, steps: int) -> Gait:
    """Split the stages of a gait in halves, the longest first, up to ``stages`` stages of equal motion."""
    begin = [int(time) for time in gait.begin]
    source = list(range(len(gait.begin)))  # the stage whose motion each of the new ones has
    while len(begin) < stages:
        ends = [*begin[1:], max(steps, begin[-1])]
        lengths = [end - start for start, end in zip(begin, ends, strict=True)]
        longest = lengths.index(max(lengths))
        begin.insert(longest + 1, (begin[longest] + ends[longest]) // 2)
        source.insert(longest + 1, source[longest])
    return Gait(np.array(begin), gait.period[source], gait.amplitude[source], gait.phase[source], gait.rest[source])


def draw_motion(rng: np.random.Generator, body: Design) -> Motion:
    """Sample a random wave or pose."""
    vertical = body == Cell.V_ACT

    # A pose: each actuator at its longest or shortest; as often all of a kind alike as each at random
    if rng.random() >= 0.7:
        rest = rng.choice([-1.0, 1.0], body.shape)
        if rng.random() < 0.5:
            rest = np.where(vertical, *rng.choice([-1.0, 1.0], 2))
        period = _log_uniform(rng, _PERIODS)
        return period, np.zeros(body.shape), rng.uniform(0, 2 * np.pi, body.shape), rest

    # A wave that travels through the body in some direction, or round its centre
    x, y = _cell_positions(body)
    # From a sine to nearly a square wave: values are cut at -1 and 1.
    gain = np.full(body.shape, _log_uniform(rng, (1.0, 4.5)))
    if rng.random() < 0.25:
        # About the centre: a wave for each turn of a rolling body
        phase = rng.choice([-1, 1]) * np.arctan2(y, x) + rng.integers(4) * np.pi / 2 * vertical
        return _log_uniform(rng, (8.0, 200.0)), gain, phase + rng.uniform(0, 2 * np.pi), np.zeros(body.shape)
    # Radians from a voxel to the next: waves of four voxels and longer
    turn_x, turn_y = rng.uniform(-1.6, 1.6, 2)
    phase = turn_x * x + turn_y * y + rng.uniform(0, 2 * np.pi) * vertical
    return _log_uniform(rng, _PERIODS), gain, phase, np.zeros(body.shape)


def mutate_gait(rng: np.random.Generator, gait: Gait, body: Design, steps: int) -> Gait:
    """Mutate ``gait`` by one to three changes, each to one stage or to all."""
    stages = len(gait.begin)
    # Three mutants of ten get another motion in one stage, which leaves earlier stages as they were.
    if stages > 1 and rng.random() < 0.3:
        gait = _replace_motion(rng, gait, body, steps)
        if rng.random() < 0.5:
            return gait
    for _ in range(rng.integers(1, 4)):
        chosen = np.zeros(stages, bool)
        chosen[rng.integers(stages)] = True
        chosen |= rng.random() < 0.4
        gait = replace(gait, **_draw_change(rng, gait, body, steps, chosen))
    return gait


def mutate_motion(rng: np.random.Generator, motion: Motion, body: Design, begin: int) -> Motion:
    """Return ``motion`` with one to three random changes that suit ``body``; it begins at control step ``begin``."""
    gait = gait_of([(begin, motion)])
    everywhere = np.ones(1, bool)
    for _ in range(rng.integers(1, 4)):
        gait = replace(gait, **_draw_change(rng, gait, body, begin, everywhere))
    return motions_of(gait)[0][1]


def _replace_motion(rng: np.random.Generator, gait: Gait, body: Design, steps: int) -> Gait:
    """Replace the motion of one stage, or of all later stages too, by a random one or another stage's."""
    # Stage to change, and its new motion
    stages = len(gait.begin)
    first, source = rng.integers(stages, size=2)
    chosen = slice(first, None if rng.random() < 0.5 else first + 1)
    motion = (float(gait.period[source]), gait.amplitude[source], gait.phase[source], gait.rest[source])
    if rng.random() < 0.6:
        motion = draw_motion(rng, body)
    fields = {name: getattr(gait, name).copy() for name in vars(gait)}
    for name, values in zip(("period", "amplitude", "phase", "rest"), motion, strict=True):
        fields[name][chosen] = values

    # Sometimes another beginning
    if first and rng.random() < 0.5:
        limits = (*gait.begin, steps)
        low = limits[first - 1]
        high = max(limits[first + 1], low)
        fields["begin"][first] = rng.integers(low, high + 1)
    return Gait(**fields)


def _draw_change(rng: np.random.Generator, gait: Gait, body: Design, steps: int, chosen: np.ndarray) -> dict:
    """Draw one random change of ``gait`` and return the changed fields; ``chosen``: mask of stages to change."""
    # Small and large mutations are equally likely.
    size = _log_uniform(rng, (0.02, 1.0))
    cells = chosen[:, None, None] * (rng.random(body.shape) < rng.choice([0.08, 0.3, 1.0]))
    noise = size * cells * rng.normal(size=body.shape)
    kind = rng.integers(7)
    if kind == 0:
        factor = np.exp(0.5 * size * rng.normal() * chosen)
        period = np.clip(gait.period * factor, SHORTEST, LONGEST)
        turns = gait.begin / gait.period - gait.begin / period
        turns -= turns.round()  # keep the phase at the stage's beginning: long times would magnify a small change
        return {"period": period, "phase": gait.phase + 2 * np.pi * turns[:, None, None]}
    if kind == 1:
        begin = gait.begin.copy()
        begin[1:] *= np.exp(size * rng.normal(size=len(begin) - 1))
        begin[1:] += rng.integers(-2, 3, len(begin) - 1)
        return {"begin": np.sort(np.clip(begin.round(), 0.0, steps))}
    if kind == 2:  # another direction or length of the wave
        x, y = _cell_positions(body)
        turn = rng.normal() * x + rng.normal() * y + 2 * rng.normal() * (body == Cell.V_ACT)
        return {"phase": gait.phase + size * chosen[:, None, None] * turn}
    if kind == 3:
        return {"phase": gait.phase + 2 * noise}
    if kind == 4:
        # A rest beyond 1 holds an actuator still for a part of the period.
        return {"rest": np.clip(gait.rest + 1.5 * noise, -2.0, 2.0)}
    if kind == 5:
        return {"amplitude": np.clip(gait.amplitude + 1.5 * noise, 0.0, 9.0)}
    # a few cells at their longest or shortest
    few = chosen[:, None, None] & (rng.random(body.shape) < 0.15)
    return {"rest": np.where(few, rng.choice([-1.0, 1.0], body.shape), gait.rest)}


def _cell_positions(body: Design) -> tuple[np.ndarray, np.ndarray]:
    """Return x (right) and y (up) of each cell relative to the mean position of the body's voxels."""
    rows, columns = np.nonzero(body)
    row, column = np.mgrid[: body.shape[0], : body.shape[1]]
    return column - columns.mean(), rows.mean() - row


def _log_uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """Draw a number between ``limits`` from a log-uniform distribution."""
    return float(np.exp(rng.uniform(*np.log(limits))))
