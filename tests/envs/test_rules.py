"""What every task computes, written down a second time: observation, reward and ends under both rules.

The book below is section B of the paper and the release in plain Python, one environment at a time. It is compared with
the terms of the tasks on made-up states on both sides of every threshold, and with the environments on the simulator.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import pi, radians
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from warpvox.design import sample_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

EXACT = 1e-11  # sums in another order


@dataclass
class Page:
    """One task under both rules; ``printed`` holds what the paper has otherwise."""

    steps: int
    obs: str
    reward: object
    ends: list = field(default_factory=list)
    printed: dict = field(default_factory=dict)

    def under(self, rules: str) -> Page:
        return self if rules == "evogym" else Page(**(vars(self) | self.printed))


# r robot, b package or beam: centre of mass; th_r, th_b orientation. Before b, after a.
def dx(b, a):
    return a.r[0] - b.r[0]


def dy(b, a):
    return a.r[1] - b.r[1]


def away(b, a, axis, goal, who="r"):
    """delta |g - p|"""
    return abs(goal - getattr(a, who)[axis]) - abs(goal - getattr(b, who)[axis])


def apart(b, a):
    """delta |p_b - p_r| in x"""
    return abs(a.b[0] - a.r[0]) - abs(b.b[0] - b.r[0])


def fall(b, a, limit, who="b"):
    now, then = getattr(a, who)[1], getattr(b, who)[1]
    return now - then if now < limit else 0.0


def carrier_1(b, a):
    return -away(b, a, 0, 4.0) + 10 * fall(b, a, 0.4 if a.b[0] > 2 else 0.6)


def pusher(b, a):
    return 0.5 * dx(b, a) + 0.75 * (a.b[0] - b.b[0]) - apart(b, a)


def thrower(weight):
    return lambda b, a: a.b[0] - b.b[0] - weight * dx(b, a) * (1 if a.r[0] >= 0 else -1)


def toppler(weight):
    def reward(b, a):
        moved = a.b - b.b
        return -apart(b, a) + abs(moved[0]) + 3 * abs(moved[1]) - weight * moved[1]

    return reward


def flip(b, a):
    turn = a.th_r - b.th_r
    if b.th_r < pi / 3 and a.th_r > 5 * pi / 3:
        return turn - 2 * pi
    return turn + 2 * pi if b.th_r > 5 * pi / 3 and a.th_r < pi / 3 else turn


def far(limit, bonus, axis=0):
    return (lambda a: a.r[axis] > limit, bonus)


def front(limit, bonus):
    return (lambda a: a.front > limit, bonus)


def turned(degrees):
    return (lambda a: radians(degrees) < a.th_r < radians(360 - degrees), -3)


LOW = (lambda a: a.r[1] < 0.4, -3)
BACK = (lambda a: a.b[0] < 0.2, 1)
CARRIED = ("v_r p_b-p_r v_b c_r", "v_b p_b-p_r v_r c_r")
TERRAIN = ("v_r th_r c_r floor5", "v_r th_r c_r elevation5")
BEAM = "p_b-p_r v_r v_b th_b c_r"


def terrain(steps, /, *ends, **printed):
    return Page(steps, TERRAIN[0], dx, list(ends), {"obs": TERRAIN[1], **printed})


def carried(steps, reward, /, *ends, **printed):
    return Page(steps, CARRIED[0], reward, list(ends), {"obs": CARRIED[1], **printed})


def balancer(x, y):
    return Page(
        *(600, "th_r c_r", lambda b, a: -away(b, a, 0, x) - away(b, a, 1, y)), printed={"obs": f"{x},{y}-p_r c_r"}
    )


BOOK = {
    "Walker-v0": Page(500, "v_r c_r", dx, [far(9.9, 1)]),
    "BridgeWalker-v0": Page(500, "v_r th_r c_r", dx, [far(6, 1)]),
    "BidirectionalWalker-v0": Page(
        *(1000, "v_r c_r count goal goal-x_r", lambda b, a: -away(b, a, 0, a.goal), [(lambda a: a.all_reached, 1)]),
        printed={"ends": []},
    ),
    "Carrier-v0": carried(
        500, lambda b, a: 0.5 * dx(b, a) + 0.5 * (a.b[0] - b.b[0]) + 10 * fall(b, a, 0.3), far(9.9, 1)
    ),
    "Carrier-v1": carried(1000, carrier_1, reward=lambda b, a: -2 * away(b, a, 0, 4.85, "b") + carrier_1(b, a)),
    "Pusher-v0": carried(500, lambda b, a: pusher(b, a) + 10 * fall(b, a, 0.0), far(9.9, 1), reward=pusher),
    "Pusher-v1": carried(
        *(600, lambda b, a: pusher(b, a) + 10 * fall(b, a, 0.0), far(6.9, 1)), reward=pusher, ends=[far(9.9, 1)]
    ),
    "Thrower-v0": carried(300, thrower(0.25), reward=thrower(1.0)),
    "Catcher-v0": Page(400, BEAM, lambda b, a: -apart(b, a) + 10 * fall(b, a, 0.5)),
    "BeamToppler-v0": Page(
        *(1000, BEAM, toppler(10), [BACK]), printed={"reward": toppler(1), "ends": [(lambda a: a.b[1] < 0.5, 1)]}
    ),
    "BeamSlider-v0": Page(1000, BEAM, lambda b, a: -apart(b, a) + a.b[0] - b.b[0], [BACK], printed={"ends": []}),
    "Lifter-v0": Page(
        *(300, "v_r p_b-p_r v_b th_b c_r"),
        lambda b, a: 10 * (a.b[1] - b.b[1]) - 10 * away(b, a, 0, 0.55, "b") + 20 * fall(b, a, 0.3, "r"),
        printed={"obs": "p_b-p_r v_r v_b th_b c_r"},
    ),
    "Climber-v0": Page(400, "v_r c_r", dy, [far(8.6, 1, axis=1)]),
    "Climber-v1": Page(600, "v_r c_r", dy, [far(6.5, 1, axis=1)]),
    "Climber-v2": Page(
        *(1000, "v_r th_r c_r ceiling3", lambda b, a: dy(b, a) + 0.2 * dx(b, a)),
        printed={"obs": "v_r th_r c_r overhang3"},
    ),
    "UpStepper-v0": terrain(600, far(6.9, 2), turned(75)),
    "DownStepper-v0": terrain(500, far(7.4, 2), turned(90)),
    "ObstacleTraverser-v0": terrain(1000, far(7.9, 2), turned(90)),
    "ObstacleTraverser-v1": terrain(1000, far(5.9, 2), ends=[front(5.7, 2)]),
    "Hurdler-v0": terrain(1000, turned(90)),
    "PlatformJumper-v0": terrain(*(1000, LOW, turned(90)), ends=[(lambda a: LOW[0](a) or turned(90)[0](a), -3)]),
    "GapJumper-v0": terrain(1000, LOW),
    "Traverser-v0": terrain(600, far(5.9, 2), steps=1000),
    "CaveCrawler-v0": Page(
        *(1000, "v_r c_r floor5 ceiling5", dx, [far(6.9, 1)]),
        printed={"obs": "v_r c_r elevation5 overhang5", "ends": [front(6.8, 1)]},
    ),
    "AreaMaximizer-v0": Page(
        *(600, "c_r", lambda b, a: 10 * (a.hull - b.hull)), printed={"reward": lambda b, a: a.hull - b.hull}
    ),
    "AreaMinimizer-v0": Page(
        *(600, "c_r", lambda b, a: -10 * (a.hull - b.hull)), printed={"reward": lambda b, a: b.hull - a.hull}
    ),
    "WingspanMaximizer-v0": Page(600, "c_r", lambda b, a: a.extent[0] - b.extent[0]),
    "HeightMaximizer-v0": Page(500, "c_r", lambda b, a: a.extent[1] - b.extent[1]),
    "Flipper-v0": Page(600, "th_r c_r", flip, [(lambda a: a.r[0] < 0.1, 0)], printed={"ends": []}),
    "Jumper-v0": Page(
        *(500, "v_r c_r floor2", lambda b, a: 10 * dy(b, a) - 5 * abs(dx(b, a))), printed={"obs": "v_r c_r elevation2"}
    ),
    "Balancer-v0": balancer(1.7, 0.5),
    "Balancer-v1": balancer(1.75, 0.6),
}
# Section B: the fixed part of the observation's dimension.
ENTRIES = [2, 3, 5, 6, 6, 6, 6, 6, 7, 7, 7, 7, 2, 2, 10, *8 * [14], 24, *4 * [0], 1, 7, 1, 1]
ENTRIES_PRINTED = [*ENTRIES[:-2], 2, 2]

ALL = pytest.mark.parametrize("task", task_ids())
BOTH = pytest.mark.parametrize("rules", ["evogym", "paper"])


def thing_of(spec) -> str | None:
    return next((obj.name for obj in spec.objects if obj.name in ("package", "beam")), None)


def look(moment: SimpleNamespace, word: str) -> np.ndarray:
    """One part of an observation as the book names it."""
    if word[:3] in ("v_r", "v_b", "th_", "c_r"):
        return np.atleast_1d(getattr(moment, word))
    if word == "p_b-p_r":
        return moment.b - moment.r
    if "," in word:
        return np.array([float(value) for value in word.removesuffix("-p_r").split(",")]) - moment.r
    if word in ("count", "goal", "goal-x_r"):
        values = {"count": moment.count, "goal": moment.seen_goal, "goal-x_r": moment.seen_goal - moment.r[0]}
        return np.array([values[word]])
    return getattr(moment, word[:-1])(int(word[-1]))


def scan(terrain: np.ndarray, centre: np.ndarray, word: str, reach: int) -> np.ndarray:
    """Floor and ceiling (released), elevation and overhang (printed), window by window from points ``[n, 2]``."""
    points, (x, y) = terrain / 0.1, centre / 0.1
    released, up = word in ("floor", "ceiling"), word in ("ceiling", "overhang")
    out = []
    for i in range(-reach, reach + 1):
        if released:
            inside = (points[:, 0] > x + i - 0.5) & (points[:, 0] < x + i + 0.5)
        else:
            inside = (points[:, 0] >= x + i) & (points[:, 0] <= x + i + 1)
        seen = points[inside & (points[:, 1] > y if up else points[:, 1] < y), 1]
        if released:
            out.append(min(abs(seen - y).min(initial=5.0), 5.0))
        elif len(seen):
            out.append(seen.min() if up else seen.max())  # at any distance
        else:
            out.append(y + 5 if up else 0.0)
    return np.array(out) * 0.1


def hull_area(points: np.ndarray) -> float:
    """By the gift that sorting by x makes (Andrew's chains)."""

    def chain(ordered):
        out: list[np.ndarray] = []
        for p in ordered:
            while len(out) > 1 and np.linalg.det([out[-1] - out[-2], p - out[-2]]) <= 0:
                out.pop()
            out.append(p)
        return out

    ordered = points[np.lexsort(points.T[::-1])]
    x, y = np.array([*chain(ordered)[:-1], *chain(ordered[::-1])[:-1]]).T
    return 0.5 * float(np.abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def test_the_book_has_every_task() -> None:
    assert list(BOOK) == task_ids()
    assert len(task_ids()) == len(ENTRIES) == 32


@ALL
@BOTH
def test_episodes_last_as_long_as_written(task: str, rules: str) -> None:
    spec = get_task(task).under(rules)
    assert spec.max_episode_steps == BOOK[task].under(rules).steps
    assert spec.unstable_penalty == -3.0


COUNT = 400
LIMITS = np.array(
    [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.7, 1.75, 2.0, 4.0, 4.85, 5.9, 6.0, 6.5, 6.9, 7.4, 7.9, 8.6, 9.9]
)


class MadeUp:
    """A state with random values, half of them close to some threshold."""

    def __init__(self, rng: np.random.Generator) -> None:
        near = rng.choice(LIMITS, (COUNT, 4)) + rng.choice([-1e-3, 1e-3], (COUNT, 4))
        anywhere = rng.uniform(-0.5, 10.5, (COUNT, 4))
        places = np.where(rng.random((COUNT, 4)) < 0.5, near, anywhere)
        edges = np.radians(rng.choice([0.5, 59, 61, 74, 76, 89, 91, 269, 271, 284, 286, 299, 301, 359], (COUNT, 2)))
        self.centres = {"robot": places[:, :2], "thing": places[:, 2:]}
        self.angles = {"robot": edges[:, 0], "thing": edges[:, 1]}
        self.about = rng.uniform(-0.4, 0.4, (COUNT, 2, 9))
        self.extents, self.hulls = rng.uniform(0.1, 1, (COUNT, 2)), rng.uniform(0.1, 1, COUNT)
        self.goals = rng.integers(20, 50, (COUNT, 64)) * (np.arange(64) < rng.integers(2, 12, (COUNT, 1)))
        self.goal = np.minimum(rng.integers(0, 12, (COUNT, 1)), (self.goals > 0).sum(1, keepdims=True))

    @staticmethod
    def _who(name: str) -> str:
        return "robot" if name == "robot" else "thing"

    def com(self, name):
        return torch.as_tensor(self.centres[self._who(name)])

    def relative_positions(self, name):
        return torch.as_tensor(self.about)

    def orientation(self, name):
        return torch.as_tensor(self.angles[self._who(name)])

    def extent(self, name):
        return torch.as_tensor(self.extents)

    def hull_area(self, name):
        return torch.as_tensor(self.hulls)

    def memory(self, name):
        return torch.as_tensor(getattr(self, name))

    def moment(self, e: int) -> SimpleNamespace:
        goals = self.goals[e][self.goals[e] > 0] * 0.1
        at = int(self.goal[e, 0])
        return SimpleNamespace(
            r=self.centres["robot"][e], b=self.centres["thing"][e], th_r=self.angles["robot"][e],
            extent=self.extents[e], hull=self.hulls[e], front=(self.about[e, 0] + self.centres["robot"][e, 0]).max(),
            goal=goals[min(at, len(goals) - 1)], all_reached=at >= len(goals),
        )  # fmt: skip


@ALL
@BOTH
def test_rewards_and_ends_are_those_of_the_book(task: str, rules: str) -> None:
    rng = np.random.default_rng(11)
    before, after = MadeUp(rng), MadeUp(rng)
    after.goals = before.goals
    after.goal = np.minimum(after.goal, (after.goals > 0).sum(1, keepdims=True))
    spec, page = get_task(task).under(rules), BOOK[task].under(rules)
    reward = sum(term(before, after) * term.weight for term in spec.rewards).numpy()
    bonus, ended = np.zeros(COUNT), np.zeros(COUNT, bool)
    for term in spec.terminations:
        hit = term(after).numpy()
        bonus, ended = bonus + hit * term.bonus, ended | hit
    moments = [(before.moment(e), after.moment(e)) for e in range(COUNT)]
    np.testing.assert_allclose(reward, [page.reward(b, a) for b, a in moments], rtol=0, atol=EXACT)
    assert bonus.tolist() == [sum(extra for test, extra in page.ends if test(a)) for _, a in moments]
    assert ended.tolist() == [any(test(a) for test, _ in page.ends) for _, a in moments]
    assert ended.any() == bool(page.ends)


def raw(env: VoxelVecEnv, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre of mass, its velocity, and relative positions (x before y) of an object, from its points."""
    points = env.sim.object_positions(name)[0].numpy()
    centre = points.mean(0)
    return centre, env.sim.object_velocities(name)[0].numpy().mean(0), (points - centre).T.ravel()


def now(env: VoxelVecEnv) -> SimpleNamespace:
    """The moment at which an environment is, from points."""
    moment, thing = SimpleNamespace(), thing_of(env.spec)
    moment.r, moment.v_r, moment.c_r = raw(env, "robot")
    moment.th_r = float(env.sim.orientation("robot"))
    if thing:
        moment.b, moment.v_b, _ = raw(env, thing)
        moment.th_b = float(env.sim.orientation(thing))
    points = env.sim.object_positions("robot")[0].numpy()
    moment.extent, moment.hull, moment.front = points.max(0) - points.min(0), hull_area(points), points[:, 0].max()
    ground = np.concatenate([env.sim.object_positions(obj.name)[0].numpy() for obj in env.spec.objects])
    for word in ("floor", "ceiling", "elevation", "overhang"):
        setattr(moment, word, lambda reach, word=word: scan(ground, moment.r, word, reach))
    return moment


def follow_goals(env: VoxelVecEnv, moment: SimpleNamespace, seen: int) -> int:
    """Fill in the goals, of which ``seen`` had been reached before the step; return how many are now."""
    goals = env.memory["goals"][0].numpy()
    goals = goals[goals > 0] * 0.1
    count = seen
    while count < len(goals) and abs(goals[count] - moment.r[0]) < 0.2:
        count += 1
    moment.count, moment.seen_goal = seen, goals[min(seen, len(goals) - 1)]
    moment.goal, moment.all_reached = goals[min(count, len(goals) - 1)], count == len(goals)
    return count


@ALL
@BOTH
def test_observations_and_rewards_follow_from_the_points(task: str, rules: str) -> None:
    body = sample_design((5, 5), seed=3)
    env = make_vec(
        *(task, [body]), device="cpu", dtype="float64", threads=1, rules=rules, auto_reset=False, seed=2, lanes=1
    )
    page, goals = BOOK[task].under(rules), 0
    rng = np.random.default_rng(0)
    speed, phase = rng.uniform(0.1, 0.6, env.num_actions), rng.uniform(0, 2 * pi, env.num_actions)
    obs, _ = env.reset()
    index = task_ids().index(task)
    fixed = (ENTRIES if rules == "evogym" else ENTRIES_PRINTED)[index]
    assert env.num_obs == fixed + 2 * env.sim.num_points("robot")
    moment = now(env)
    if env.memory.keys() >= {"goals"}:
        goals = follow_goals(env, moment, 0) * 0
    for step in range(24):
        wanted = np.concatenate([look(moment, word) for word in page.obs.split()])
        np.testing.assert_allclose(obs[0], wanted, rtol=0, atol=EXACT)
        obs, reward, terminated, truncated, info = env.step(1.1 + 0.55 * np.sin(speed * step + phase)[None])
        before, moment = moment, now(env)
        if env.memory.keys() >= {"goals"}:
            goals = follow_goals(env, moment, goals)
        bonus = sum(extra for test, extra in page.ends if test(moment))
        assert not info["unstable"].any()
        assert float(reward) == pytest.approx(page.reward(before, moment) + bonus, abs=EXACT)
        assert bool(terminated) == any(test(moment) for test, _ in page.ends)
        assert not truncated.any()
        if terminated:
            break


# The face of the wall that closes the terrain, a height above the ground before it, the bonus.
WALLS = {"CaveCrawler-v0": (69, 1, 1.0), "ObstacleTraverser-v1": (58, 5, 2.0)}


def arrived(task: str, rules: str, shape: tuple[int, int], gap: int) -> tuple[bool, float]:
    """Whether a body that begins ``gap`` voxels before the wall has ended its episode a step later, and its bonus."""
    wall, height, _ = WALLS[task]
    spec = replace(get_task(task), robot_cell=(wall - gap - shape[1], height))
    body = np.full(shape, 3)
    env = make_vec(spec, [body], device="cpu", dtype="float64", threads=1, rules=rules, auto_reset=False, lanes=1)
    env.reset()
    before = float(env.sim.com("robot")[0, 0])
    _, reward, terminated, _, _ = env.step(torch.ones((1, env.num_actions), dtype=torch.float64))
    return bool(terminated), float(reward) - (float(env.sim.com("robot")[0, 0]) - before)


@pytest.mark.parametrize("shape", [(2, 1), (3, 3), (2, 5), (3, 9)])
@pytest.mark.parametrize("task", WALLS)
def test_bodies_of_any_width_arrive_at_a_wall_that_closes_the_terrain(task: str, shape: tuple[int, int]) -> None:
    assert arrived(task, "paper", shape, gap=2) == (False, pytest.approx(0.0))
    assert arrived(task, "paper", shape, gap=0) == (True, pytest.approx(WALLS[task][2]))
    assert not arrived(task, "evogym", shape, gap=0)[0]  # as released: the centre of mass would have to be in the wall
