"""What terms say about themselves is what they do: their formulas are computed and compared."""

import re
from math import radians

import numpy as np
import pytest
import torch

from warpvox.envs.about import UNITS, about, about_of
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import observes
from warpvox.envs.vec_env import make_vec
from warpvox.types import RULES

COUNT, EXACT = 300, 1e-12
# Said in words, because they are no expressions of centres and angles; tests/envs/test_rules.py computes them.
IN_WORDS = {"grown", "hull", "turned", "approach_goal", "all_goals_reached", "reaches"}
EACH = pytest.mark.parametrize(
    ("task", "rules"),
    [(task, rules) for task in task_ids() for rules in RULES if rules == "evogym" or get_task(task).paper],
)


class Moment:
    """Centres and angles of all objects, drawn around the numbers that occur in a formula."""

    def __init__(self, rng: np.random.Generator, numbers: list[float]) -> None:
        self._rng, self._numbers, self._known = rng, [*numbers, 0.0], {}

    def _drawn(self, key: str, *shape: int) -> torch.Tensor:
        if key not in self._known:
            near = self._rng.choice(self._numbers, (COUNT, *shape)) + self._rng.choice([-0.01, 0.01], (COUNT, *shape))
            far = self._rng.uniform(-1, 10, (COUNT, *shape))
            self._known[key] = torch.as_tensor(np.where(self._rng.random((COUNT, *shape)) < 0.6, near, far))
        return self._known[key]

    def com(self, name: str) -> torch.Tensor:
        return self._drawn(f"p_{name}", 2)

    def orientation(self, name: str) -> torch.Tensor:
        return self._drawn(f"θ_{name}")

    def names(self, number: int) -> dict[str, float]:
        """The words of formulas: x, y and θ of every object."""
        out = {}
        for key, value in self._known.items():
            kind, _, name = key.partition("_")
            row = value[number]
            out |= {f"x_{name}": float(row[0]), f"y_{name}": float(row[1])} if kind == "p" else {key: float(row)}
        return out


def read(text: str) -> str:
    """A formula as Python, in which ``D(text)`` is the change of an expression."""
    text = re.sub(r"([\d.]+)°", lambda m: repr(radians(float(m[1]))), text)
    condition = re.fullmatch(r"\[(.+?)\] (.*)", text)
    if condition:
        return f"({read(condition[2])}) if ({condition[1]}) else 0.0"
    text = re.sub(r"Δ\|([^|]+)\|", r"D('abs(\1)')", text)
    text = re.sub(r"Δ(\w+)", r"D('\1')", text)
    return re.sub(r"\|([^|]+)\|", r"abs(\1)", text)


def computed(formula: str, before: Moment, after: Moment) -> list[float]:
    code = read(formula)
    out = []
    for number in range(COUNT):
        then, now = before.names(number), after.names(number)
        change = {"D": lambda text, then=then, now=now: eval(text, {}, now) - eval(text, {}, then)}
        out.append(float(eval(code, change, now)))
    return out


def numbers_of(term: object) -> list[float]:
    return [value for _, value in term.params if isinstance(value, float)]


@EACH
def test_formulas_of_rewards_and_ends_are_true(task: str, rules: str) -> None:
    spec = get_task(task).under(rules)
    rng = np.random.default_rng(4)
    for term in (*spec.rewards, *spec.terminations):
        assert about_of(term.function), term.name
        if term.function.__name__ in IN_WORDS:
            continue
        before, after = Moment(rng, numbers_of(term)), Moment(rng, numbers_of(term))
        is_reward = term in spec.rewards
        value = (term(before, after) if is_reward else term(after)).double()
        np.testing.assert_allclose(value, computed(term.formula, before, after), rtol=0, atol=EXACT)
        assert len(np.unique(value)) > 1  # both sides of every condition were met


@EACH
def test_observations_have_the_sizes_units_and_bounds_that_they_say(task: str, rules: str) -> None:
    env = make_vec(task, ["hopper"], device="cpu", rules=rules, dtype="float64", threads=1)
    obs, _ = env.reset()
    for term in env.spec.observations:
        described, place = about_of(term.function), env.obs_columns[0][term.name]
        assert described.unit in UNITS
        name = dict(term.params)["name"]
        assert described.size(dict(term.params), env.sim.num_points(name)) == place.stop - place.start
        assert (obs[0, place] >= described.low).all()
        assert (obs[0, place] <= described.high).all()
        assert "{" not in term.formula


def test_a_function_that_says_nothing_is_called_by_its_name() -> None:
    def mine(state, name, reach):
        """No formula."""

    unknown = observes(mine, "ball", reach=3)
    assert unknown.formula == "mine(name=ball, reach=3)"
    assert (unknown.about.low, unknown.about.high, unknown.about.unit) == (-np.inf, np.inf, "number")
    assert about("{name} up", low=0.0)(mine) is mine
    assert (unknown.formula, unknown.about.low) == ("ball up", 0.0)
