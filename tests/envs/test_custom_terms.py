"""What a user's terms may get wrong: found when environments are made, or caught and named when it happens."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from warpvox.envs.about import about
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import Memory, TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.observations import velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import DeviceError, SimulationError, TaskError
from warpvox.types import AXES

ENVS = 3
BASE = replace(get_task("Walker-v0"), id="Mine-v0")


def make(spec: TaskSpec, **options: Any) -> VoxelVecEnv:
    return make_vec(spec, ["mini"], ENVS, **({"device": "cpu", "threads": 1} | options))


def acting(env: VoxelVecEnv) -> torch.Tensor:
    return torch.full((env.num_envs, env.num_actions), 1.3)


def odd(function: Callable) -> Callable:
    """A function under the name that messages are looked for."""
    function.__name__ = "odd"
    return function


def x_of(state: Any, name: str = "robot") -> torch.Tensor:
    return state.com(name)[:, 0]


BAD_REWARDS = [
    lambda b, a, name: x_of(a)[:, None],
    lambda b, a, name: x_of(a).mean(),
    lambda b, a, name: None,
    lambda b, a, name: torch.zeros(3, device="meta"),
    lambda b, a, name: (x_of(a) - x_of(b)) / (x_of(a) - x_of(b)).abs(),
]
BAD_OBSERVATIONS = [
    lambda s, name: x_of(s),
    lambda s, name: s.positions(name),
    lambda s, name: s.com(name) / 0,
    about("x, y")(lambda s, name: s.com(name)),
]
BAD_TERMINATIONS = [lambda s, name: x_of(s), lambda s, name: x_of(s)[:, None] > 9]
BAD_MEMORIES = [
    (lambda d: torch.zeros(4, 1), None),
    (lambda d: d.zeros(1), lambda s: s.memory("odd").double()),
    (lambda d: d.zeros(1), lambda s: s.memory("od")),
    (lambda d: d.integers(5, 5, 1), None),
    (lambda d: 1 // 0, None),
]


@pytest.mark.parametrize(
    "changes",
    [
        *({"rewards": (*BASE.rewards, rewards(odd(function)))} for function in BAD_REWARDS),
        *({"observations": (*BASE.observations, observes(odd(function)))} for function in BAD_OBSERVATIONS),
        *({"terminations": (terminates(odd(function)),)} for function in BAD_TERMINATIONS),
        *({"memory": (Memory("odd", *functions),)} for functions in BAD_MEMORIES),
    ],
)
def test_parts_are_checked_by_name_when_environments_are_made(changes: dict) -> None:
    with pytest.raises(TaskError) as caught:
        make(replace(BASE, **changes))
    assert "'odd" in str(caught.value)


def test_randomized_objects_are_checked() -> None:
    task = get_task("Catcher-v0")
    with pytest.raises(TaskError):
        replace(task, id="Mine-v0", randomized=("bal",))
    for start in (lambda d: torch.zeros(3, 2), lambda d: d.zeros(3)):
        with pytest.raises(TaskError):
            make(replace(task, id="Mine-v0", memory=(Memory("offset", start),)))


def velocity_along(state: Any, name: str, axis: str) -> torch.Tensor:
    return state.velocity(name)[:, [AXES[axis]]]


BAD_WORDS = [(displacement, {"axs": "x"}), (displacement, {"axis": "x", "wight": 2}), (velocity, {})]


@pytest.mark.parametrize(("function", "words"), BAD_WORDS)
def test_parameters_are_checked_when_a_term_is_written(function: Callable, words: dict) -> None:
    with pytest.raises(TaskError):
        rewards(function, **words)


def lookup(state: Any, name: str) -> torch.Tensor:
    return torch.zeros(len(state.com("robot")), {"a": 1}[name])


@pytest.mark.parametrize("term", [observes(velocity, "robbot"), observes(velocity_along, axis="z"), observes(lookup)])
def test_errors_within_a_term_name_it(term: Any) -> None:
    spec = replace(BASE, observations=(*BASE.observations, term))
    with pytest.raises(TaskError) as caught:
        make(spec)
    assert caught.value.__cause__ is not None


def test_an_error_that_comes_later_names_its_term_too() -> None:
    count = iter(range(100))

    def late(before: Any, after: Any, name: str) -> torch.Tensor:
        if next(count) > 3:
            raise ValueError("enough")
        return x_of(after) - x_of(before)

    env = make(replace(BASE, rewards=(rewards(late),)))
    env.reset()
    with pytest.raises(TaskError):
        for _ in range(10):
            env.step(acting(env))


def test_a_lack_of_memory_stays_one() -> None:
    def greedy(before: Any, after: Any, name: str) -> torch.Tensor:
        raise MemoryError("not enough memory")

    with pytest.raises(DeviceError):
        make(replace(BASE, rewards=(rewards(greedy),)))


AT = 4


def blinking(kind: str, value: float, victims: list[int]) -> TaskSpec:
    """A task with a term that is not finite in some environments in the step in which a memory has counted to 4."""

    def faulty(state: Any) -> torch.Tensor:
        count = state.memory("count")[:, 0]
        rows = torch.zeros_like(count, dtype=torch.bool)
        rows[victims] = True
        return rows & (count == AT)

    def reward(before: Any, after: Any, name: str) -> torch.Tensor:
        return (x_of(after) - x_of(before)).masked_fill(faulty(after), value)

    def seen(state: Any, name: str) -> torch.Tensor:
        return state.com(name).masked_fill(faulty(state)[:, None], value)

    count = Memory("count", lambda draws: draws.zeros(1), lambda state: state.memory("count") + 1)
    reward.__name__ = seen.__name__ = "faulty"
    spec = replace(BASE, memory=(count,))
    if kind == "reward":
        return replace(spec, rewards=(*spec.rewards, rewards(reward)))
    return replace(spec, observations=(observes(seen), *spec.observations))


@pytest.mark.parametrize("looks", [True, False], ids=["CPU", "as on CUDA"])
@pytest.mark.parametrize("auto_reset", [True, False])
@pytest.mark.parametrize("kind", ["reward", "observation"])
def test_a_term_that_is_not_finite_ends_its_environments(kind: str, auto_reset: bool, looks: bool) -> None:
    # an observation of a step is made before the memory counts it
    at = AT if kind == "reward" else AT + 1
    value = float("nan") if auto_reset else float("-inf")
    env = make(blinking(kind, value, [1]), auto_reset=auto_reset)
    calm = make(blinking(kind, value, []), auto_reset=auto_reset)
    env._on_cpu = env._finite.on_cpu = looks
    obs, _ = env.reset()
    assert torch.equal(obs, calm.reset()[0])
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        for step in range(1, at + 4):
            obs, reward, terminated, truncated, info = env.step(acting(env))
            wanted = calm.step(acting(env))
            assert torch.isfinite(obs).all()
            assert torch.isfinite(reward).all()
            assert torch.isfinite(info["final_obs"]).all()
            assert all(torch.isfinite(part).all() for part in info["reward_terms"].values())
            assert info["diverged"].tolist() == info["unstable"].tolist() == [False, step == at, False]
            assert terminated.tolist() == [False, step == at or (step > at and not auto_reset), False]
            assert not truncated.any()
            others = [0, 2] if step >= at else [0, 1, 2]
            assert torch.equal(obs[others], wanted[0][others])
            assert torch.equal(reward[others], wanted[1][others])
            if step == at:
                assert reward[1] == BASE.unstable_penalty == info["reward_terms"]["unstable"][1]
            elif step > at and not auto_reset:
                assert reward[1] == 0.0
        assert env.not_finite() == {f"{kind} faulty_robot": 1}
        assert env.not_finite() == {f"{kind} faulty_robot": 1}
    (warning,) = [entry for entry in heard if entry.category is RuntimeWarning]
    assert f"The {kind} 'faulty_robot' of the task 'Mine-v0' was NaN or infinite in 1 environment," in str(
        warning.message
    )


@pytest.mark.parametrize("kind", ["reward", "observation"])
def test_a_single_environment_that_a_term_has_ended_stays_so(kind: str) -> None:
    env = VoxelEnv(blinking(kind, float("nan"), [0]), body="mini")
    env.reset()
    for _ in range(AT - (kind == "reward")):
        env.step(env.action_space.high)
    with pytest.warns(RuntimeWarning, match="'faulty_robot'"):
        obs, reward, ended, *_ = env.step(env.action_space.high)
    assert (reward, ended) == (BASE.unstable_penalty, True)
    again, reward, ended, *_ = env.step(env.action_space.low)
    assert (reward, ended) == (0.0, True)
    assert (again == obs).all()


def test_a_reward_about_the_state_before_sees_it() -> None:
    """Also where nothing asks the state after for the same."""

    def began(before: Any, after: Any, name: str) -> torch.Tensor:
        return x_of(before)

    env = make(replace(BASE, observations=(observes(velocity),), rewards=(rewards(began),)))
    env.reset()
    for _ in range(4):
        x = env.sim.com("robot")[:, 0]
        assert torch.equal(env.step(acting(env))[4]["reward_terms"]["began_robot"], x)


def test_a_first_observation_that_is_not_finite_is_marked() -> None:
    def unlucky(state: Any, name: str) -> torch.Tensor:
        return 1.0 / state.memory("luck")

    luck = Memory("luck", lambda draws: draws.zeros(1).double() + 1)
    env = make(replace(BASE, memory=(luck,), observations=(*BASE.observations, observes(unlucky))))
    with pytest.warns(RuntimeWarning, match="'unlucky_robot'"):
        obs, _ = env.reset(memory={"luck": [[1.0], [0.0], [1.0]]})
    assert torch.isfinite(obs).all()
    assert env.not_finite()["observation unlucky_robot"] == 1


def test_what_a_term_does_to_its_values_is_its_own_affair() -> None:
    def spoil(state: Any) -> None:
        seen = (quantity("robot") for quantity in (state.com, state.velocity, state.relative_positions))
        for value in (*seen, state.memory("m")):
            value.mul_(0).add_(7)

    def spoiler(state: Any, name: str) -> torch.Tensor:
        spoil(state)
        return state.com(name)

    def spoiling(before: Any, after: Any, name: str) -> torch.Tensor:
        spoil(before)
        spoil(after)
        return x_of(after) - x_of(before)

    def spoilt(state: Any, name: str) -> torch.Tensor:
        spoil(state)
        return x_of(state) < -1

    memory = (Memory("m", lambda draws: draws.integers(0, 9, 1)),)
    plain = replace(BASE, memory=memory)
    rough = replace(
        plain,
        observations=(observes(spoiler), *plain.observations),
        rewards=(rewards(spoiling), *plain.rewards),
        terminations=(terminates(spoilt), *plain.terminations),
    )
    env, calm = make(rough, seed=5), make(plain, seed=5)
    assert torch.equal(env.reset()[0][:, 2:], calm.reset()[0])
    for _ in range(5):
        obs, _, _, _, info = env.step(acting(env))
        wanted, reward, _, _, _ = calm.step(acting(env))
        assert torch.equal(obs[:, 2:], wanted)
        assert torch.equal(info["reward_terms"]["displacement_robot_x"].to(reward.dtype), reward)
        assert torch.equal(info["reward_terms"]["spoiling_robot"], info["reward_terms"]["displacement_robot_x"])
        assert torch.equal(env.memory["m"], calm.memory["m"])


@pytest.mark.parametrize("module", ["mine", "operators", "warpvox_mine"])
def test_a_function_of_any_module_but_ours_is_code_of_the_users_own(module: str) -> None:
    function = odd(lambda state, name: x_of(state)[:, None])
    function.__module__ = module
    assert replace(BASE, observations=(*BASE.observations, observes(function))).has_code
    assert not any(get_task(task).has_code for task in task_ids())  # Catcher-v0 has a function of the module operator


@pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0"])
def test_a_state_that_does_not_fit_is_refused_by_name(task: str) -> None:
    env = make(get_task(task))
    env.reset()
    env.step(acting(env))
    good = env.state()
    flat = [name for name in good if isinstance(good[name], torch.Tensor)]
    without = lambda values, name: {k: v for k, v in values.items() if k != name}  # noqa: E731
    wrong: list[tuple[str, Any]] = [(name, without(good, name)) for name in good if name not in ("world", "actions")]
    for name in flat:
        wrong += [(name, good | {name: value}) for value in (None, 3, good[name][:2])]
        if name != "actions":  # which may be of another precision
            wrong.append((name, good | {name: good[name].to(torch.float16)}))
    for group in ("sim", "memory"):
        wrong.append((group, good | {group: 7}))
        for name, value in good[group].items():
            wrong.append((name, good | {group: without(good[group], name)}))
            wrong += [(name, good | {group: good[group] | {name: other}}) for other in (value[:2], [1.0])]
    for field, state in wrong:
        with pytest.raises(SimulationError) as caught:
            env.set_state(state)
        assert field in str(caught.value)
    with pytest.raises(SimulationError):
        env.set_state(None)
    expected = env.step(acting(env))
    env.set_state(good)
    assert all(torch.equal(a, b) for a, b in zip(expected[:4], env.step(acting(env))[:4], strict=True))


def test_a_state_of_training_that_does_not_fit_is_refused_by_name() -> None:
    env = RslRlVecEnv(make(get_task("Walker-v0")), reward_gamma=0.99)
    good = env.state()
    for name in ("env", "obs", "shortened", "sums"):
        with pytest.raises(SimulationError):
            env.set_state({key: value for key, value in good.items() if key != name})
    with pytest.raises(SimulationError):
        env.set_state(good | {"reward_norm": {"return": good["reward_norm"]["return"]}})
    env.set_state(good)
