"""Record runs of the reference simulator for the parity tests.

Needs an interpreter that has the reference (PyPI's evogym 2.0.0 installs on Python 3.10 only):

    python3.10 -m venv reference && reference/bin/pip install evogym==2.0.0
    reference/bin/python tests/parity/record.py --out tests/parity/recordings

Another ``--seed`` draws other bodies and other actions; ``--whole`` records 100 whole episodes of random bodies, whose
returns ``judge.py`` compares. A file ``<task>.npz`` holds several runs. Of run k:
``r{k}_body`` int8, ``r{k}_actions`` int16 (times 1/1024, so exact in every float format; they leave [0.6, 1.6] on
purpose), ``r{k}_dyn`` the points that can move, ``r{k}_frames`` the rows (0: after reset, t + 1: after step t) of
``r{k}_pos`` [frames, 2, moving points] and ``r{k}_obs`` [frames, observation], and ``r{k}_reward``,
``r{k}_terminated``, ``r{k}_truncated`` of every step. ``meta`` is JSON: task, versions, and per run its objects
(name, first and last point), the step that self-folding stopped (-1: none) and what was random (``offset``, ``goals``).
"""

import argparse
import contextlib
import io
import json
import random
import warnings
import zlib
from pathlib import Path

import numpy as np

THOROUGH = ("Walker-v0", "UpStepper-v0", "Carrier-v0", "Climber-v0")  # all bodies; the other tasks have two runs
FRAMES = (0, 1, 2, 3, 5, 8, 12, 20, 30, 40, 50, 60)
STEPS = 200
SCALE = 1024
FIXED, ACTUATORS = 5, (3, 4)
BODIES = {
    "every cell type": [[1, 3, 2, 3, 1], [4, 4, 3, 4, 4], [4, 2, 3, 2, 4], [4, 0, 0, 0, 4], [4, 0, 0, 0, 4]],
    "walker": [[1, 4, 4, 4, 1], [3, 3, 3, 3, 3], [3, 3, 3, 3, 3], [4, 4, 0, 4, 4], [4, 4, 0, 4, 4]],
}
OTHER_SHAPES = ((5, 5), (3, 3), (5, 7), (10, 10))
SHAPES = {  # the shaft is 5 wide, the package hangs 5 above the ground
    "Climber-v0": ((5, 5), (3, 3), (7, 5), (10, 5)),
    "Carrier-v0": ((5, 5), (3, 3), (5, 7), (5, 10)),
}
FOLDING_BODY = [[3, 3, 1, 2, 0], [4, 0, 0, 2, 4], [4, 2, 0, 3, 1], [3, 2, 0, 2, 1], [4, 3, 3, 2, 0]]
FOLDING_SEED = 50064  # its square waves fold that body in Walker-v0


def draw(seed, *key):
    """A generator for one purpose, the same on every machine."""
    return np.random.default_rng([seed, zlib.crc32("|".join(map(str, key)).encode())])


def sample_body(shape, rng):
    """A random valid body with fewer holes than the usual rule leaves, which large bodies need to be connected."""
    from evogym.utils import has_actuator, is_connected

    while True:
        body = rng.choice(5, size=shape, p=[0.12, 0.22, 0.22, 0.22, 0.22])
        if is_connected(body) and has_actuator(body):
            return body


def waves(body, rng, kind, steps=STEPS):
    """Actions [steps, actuators] as integers."""
    count = int(np.isin(body, ACTUATORS).sum())
    t = np.arange(steps)[:, None]
    if kind == "sine":
        phase = 2 * np.pi * (rng.uniform(0.01, 0.1, count) * t + rng.uniform(0, 1, count))
        return np.rint((1.1 + 0.55 * np.sin(phase)) * SCALE).astype(np.int16)
    if kind == "square":
        period, phase = rng.integers(3, 15, count), rng.integers(0, 15, count)
        return np.where((t + phase) // period % 2 == 0, 614, 1639).astype(np.int16)
    return rng.integers(615, 1639, size=(steps, count)).astype(np.int16)


def moving_points(env, order):
    """Indices of the points that no fixed cell holds, found by their coordinates at time 0."""
    held = set()
    for name in order:
        thing = env.world.objects[name]
        for y, x in zip(*np.nonzero(np.asarray(thing.grid) == FIXED), strict=False):
            held |= {(name, thing.pos.x + x + dx, thing.pos.y + y + dy) for dx in (0, 1) for dy in (0, 1)}
    moving, first = [], 0
    for name in order:
        lattice = np.rint(env.sim.object_pos_at_time(0, name)).astype(int).T
        moving += [first + k for k, (x, y) in enumerate(lattice) if (name, x, y) not in held]
        first += len(lattice)
    return np.array(moving, dtype=np.int32)


def record(task, body, actions):
    """One episode, at most as long as the actions."""
    import gymnasium as gym

    env = gym.make(released(task), body=body.astype(float))
    obs, _ = env.reset()
    base = env.unwrapped
    drawn = {}
    if hasattr(base, "offsetx"):
        drawn["offset"] = [int(base.offsetx), int(base.offsety)]
    if hasattr(base, "goals"):
        drawn["goals"] = [int(goal.x_goal) for goal in base.goals]
    raw = super(type(base.sim), base.sim)
    objects = base.world.objects
    order = sorted(objects, key=lambda name: (not np.isin(objects[name].grid, ACTUATORS).any(), name))
    dyn = moving_points(base, order)
    frames, pos, seen, reward, ended = [0], [np.array(raw.pos_at_time(0))[:, dyn]], [obs], [], []
    unstable_at = -1
    for t, action in enumerate(actions.astype(float) / SCALE):
        before = base.sim.get_time()
        with contextlib.redirect_stdout(io.StringIO()):
            obs, r, terminated, truncated, _ = env.step(action.copy())
        reward.append(r)
        ended.append((terminated, truncated))
        if base.sim.get_time() == before:
            unstable_at = t
        if t + 1 in FRAMES or unstable_at == t:
            frames.append(t + 1)
            pos.append(np.array(raw.pos_at_time(base.sim.get_time()))[:, dyn])
            seen.append(obs)
        if terminated or truncated:
            break
    counts = [base.sim.object_pos_at_time(0, name).shape[1] for name in order]
    stops = np.cumsum(counts).tolist()
    info = dict(
        unstable_at=unstable_at,
        objects=[dict(name=n, start=b - c, stop=b) for n, b, c in zip(order, stops, counts, strict=False)],
        **drawn,
    )
    env.close()
    return info, dict(
        body=body.astype(np.int8), actions=actions[: len(reward)], dyn=dyn, frames=np.array(frames, np.int16),
        pos=np.array(pos), obs=np.array(seen, dtype=float), reward=np.array(reward, dtype=float),
        terminated=np.array([e[0] for e in ended]), truncated=np.array([e[1] for e in ended]),
    )  # fmt: skip


def runs_of(task, seed):
    """(name, body, actions) of every run."""
    if task not in THOROUGH:
        for kind in ("sine", "noise"):
            rng = draw(seed, task, kind)
            body = sample_body((5, 5), rng)
            yield f"random 5x5, {kind}", body, waves(body, rng, kind)
        return
    for name, rows in BODIES.items():
        for kind in ("sine", "noise") if name == "every cell type" else ("sine",):
            body = np.array(rows)
            yield f"{name}, {kind}", body, waves(body, draw(seed, task, name, kind), kind)
    for shape in SHAPES.get(task, OTHER_SHAPES):
        rng = draw(seed, task, shape)
        body = sample_body(shape, rng)
        yield f"random {shape[0]}x{shape[1]}, sine", body, waves(body, rng, "sine")
    if task == "Walker-v0":
        body = np.array(FOLDING_BODY)
        yield "folding, square", body, waves(body, np.random.default_rng(FOLDING_SEED), "square")


def mend():
    """Let objects of one voxel, which Traverser-v0 has, be connected to nothing: the reference reads stray memory."""
    import evogym.sim

    class Zeros:
        def __getattr__(self, name):
            return getattr(np, "zeros" if name == "empty" else name)

    evogym.sim.np = Zeros()


def whole_runs_of(task, seed):
    """Three whole episodes of random bodies, four of the thorough tasks."""
    import gymnasium as gym

    steps = gym.spec(released(task)).max_episode_steps
    for k in range(4 if task in THOROUGH else 3):
        rng = draw(seed, task, "whole", k)
        body = sample_body((5, 5), rng)
        yield f"random 5x5, number {k}", body, waves(body, rng, "sine", steps)


def all_tasks():
    """Our ids of the reference's tasks."""
    from evogym.utils import BASELINE_ENV_NAMES

    return [task.replace("Mazimizer", "Maximizer") for task in BASELINE_ENV_NAMES]


def released(task):
    """The reference's id of a task."""
    return task.replace("WingspanMax", "WingspanMaz")


def checksums(task):
    """Of every object but the robot: x, y, width, height and CRC of the cells, before any random shift."""
    import gymnasium as gym

    base = gym.make(released(task), body=np.array([[3.0]])).unwrapped
    dx, dy = getattr(base, "offsetx", 0), getattr(base, "offsety", 0)
    out = {}
    for name, thing in sorted(base.world.objects.items()):
        grid = np.ascontiguousarray(thing.grid[::-1]).astype(np.int8)  # theirs has the bottom row first
        if not np.isin(grid, ACTUATORS).any():
            moved = name != "ground"
            place = [int(thing.pos.x) - dx * moved, int(thing.pos.y) - dy * moved]
            out[name] = [*place, grid.shape[1], grid.shape[0], zlib.crc32(grid.tobytes())]
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="*", help="default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--whole", action="store_true", help="whole episodes, for their returns")
    parser.add_argument("--worlds", action="store_true", help="write OUT/worlds.json instead")
    args = parser.parse_args()
    warnings.filterwarnings("ignore")
    with contextlib.redirect_stdout(io.StringIO()):
        import evogym.envs  # noqa: F401  (registers the tasks)
    mend()
    if args.worlds:
        lines = [f"{json.dumps(task)}: {json.dumps(checksums(task))}" for task in all_tasks()]
        (args.out / "worlds.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
        return
    args.out.mkdir(parents=True, exist_ok=True)
    for task in args.tasks or all_tasks():
        random.seed(args.seed)
        chosen = (whole_runs_of if args.whole else runs_of)(task, args.seed)
        runs = [({"name": name, **info}, arrays) for name, body, actions in chosen
                for info, arrays in [record(task, body, actions)]]  # fmt: skip
        store = {f"r{k}_{key}": value for k, (_, arrays) in enumerate(runs) for key, value in arrays.items()}
        meta = dict(task=task, seed=args.seed, reference="evogym 2.0.0", runs=[info for info, _ in runs])
        path = args.out / f"{task}.npz"
        np.savez_compressed(path, meta=np.array(json.dumps(meta)), **store)
        folds = [info["unstable_at"] for info, _ in runs]
        print(f"{task}: {len(runs)} runs, unstable at {folds}, {path.stat().st_size / 1e3:.0f} KB", flush=True)


if __name__ == "__main__":
    main()
