"""Training, evaluation and recording of policies."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from warpvox.checks import check_flag, check_path
from warpvox.errors import ConfigError
from warpvox.keys import Settings, changed, check_known, in_words

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from warpvox.algos.training.loading import TrainedRun
    from warpvox.algos.training.policy_table import PolicyTable
    from warpvox.algos.training.settings import Training
    from warpvox.batch.options import SimOptions
    from warpvox.envs.spec import TaskSpec
    from warpvox.runs import Run
    from warpvox.view.rollout import Rollout


class PlayKeywords(TypedDict, total=False):
    """Options of an evaluation as keywords."""

    device: str
    dtype: str
    arithmetic: str | None
    threads: int | None
    memory_check: bool


def train(
    task: str | TaskSpec | Training | None = None,
    design: Any = None,
    *,
    folder: str | Path | None = "auto",
    progress: bool = True,
    listeners: Sequence[Callable[[Mapping[str, float]], object]] = (),
    resume: str | Path | None = None,
    sim: SimOptions | None = None,
    **settings: Any,
) -> TrainedRun:
    """Train a policy as ``warpvox train`` does, with the same defaults; return the trained run.

    The same seed gives the same policy. An interrupt (Ctrl-C, a notebook's stop button) waits for the end of the
    iteration, saves, and raises KeyboardInterrupt; ``resume="latest"`` goes on. torch's threads and random numbers are
    as before when the call returns.

    Args:
        task: an id, ``file.py:NAME``, a specification of your own, or all settings as a :class:`warpvox.Training`.
        design: a body: an array, a name, a file, or ``{robot: body}``; many bodies for one policy are ``designs``.
        folder: of the run; ``auto``: a new one in ``output_dir``; None: nothing is written.
        progress: show messages and a live line.
        listeners: functions that are called after each iteration with its row of ``metrics.csv``; what one raises ends
            the training.
        resume: a run to go on with: ``latest``, its folder, a checkpoint in it; settings are what changes.
        sim: how environments are computed; also by name, ``device="cpu"``, which goes before what ``sim`` says.
        settings: fields of :class:`warpvox.Training`; ``ppo`` may be the name of a set, ``ppo="evogym"``, of which a
            ``task`` that is settings, or a run, takes ``ppo`` alone. A mapping changes what it names, of their part.

    Raises:
        ConfigError: an unknown setting, or a value that it does not take. WarpvoxError: as the command, in words.
        KeyboardInterrupt: interrupted; the state has been saved, if there is a folder.
    """
    from warpvox.algos.find import find_run
    from warpvox.algos.training.job import Job
    from warpvox.algos.training.loading import TrainedRun
    from warpvox.algos.training.settings import Training
    from warpvox.batch.options import SimOptions
    from warpvox.code import KEYS, with_passed_code
    from warpvox.progress.training import Notebook, Terminal, with_tracker
    from warpvox.runs import TRAINING

    # What is given, of the simulation what is not the default
    options = SimOptions.of(sim, {}, train)
    given = {name: value for name, value in vars(options).items() if value != getattr(SimOptions, name)}
    for name in given.keys() & {"layout", "cuda_graph"}:
        raise ConfigError(f"sim.{name} cannot be given: a training chooses it.")
    if "grid" in given:
        raise ConfigError("sim.grid cannot be given: the room for bodies is designs={'grid': [rows, columns]}.")
    given |= settings
    if design is not None:
        given["design"] = design

    # What it is given beside: the settings of a task that is settings, or of a run
    base = None
    if isinstance(task, Training):
        base = task
    elif task is not None:
        given["task"] = task
    resume = base.resume if resume is None and base is not None else resume
    check_flag("progress", progress)
    place = None if folder is None else check_path("folder", folder)
    if resume is not None and folder != "auto":
        raise ConfigError("A run that is resumed goes on in its folder: folder cannot be given with it.")
    if str(folder) == "latest":
        raise ConfigError("folder cannot be 'latest', by which everything else knows the run that began last.")
    source = None
    if resume is not None:
        where = given.get("output_dir", Training.output_dir if base is None else base.output_dir)
        source = find_run(str(resume), str(where), TRAINING, resume=True)
        base = Training.of(source.config) if base is None else base
        given["resume"] = str(source.folder)
    if isinstance(given.get("ppo"), str):
        from warpvox.configs.composition import settings_named

        others = settings_named("train", ppo=given.pop("ppo"))
        given = (others if base is None else {"ppo": others["ppo"]}) | given

    # Settings
    given = check_known(given, train, Training)
    named = set(_dotted(given))
    if isinstance(task, Training):  # a pretrained policy must agree with what it says, too
        usual = vars(Training())
        own = _dotted({key: value for key, value in vars(task).items() if value != usual[key]})
        named |= {key for key in own if not key.startswith("design")}
    if base is not None:  # what a mapping does not name stays as it is there
        for key, value in given.items():
            value = {"bodies": value} if key == "designs" and isinstance(value, str | list | tuple) else value
            if isinstance(part := getattr(base, key), Settings) and isinstance(value, Mapping):
                given[key] = changed(part, value, key)
    config = Training(**given) if base is None else dataclasses.replace(base, **given)
    # What the user's own settings name was passed; of the settings of a run only what is given beside it.
    passed = given if base is not None and not isinstance(task, Training) else KEYS
    config = with_passed_code(config, passed, resume)

    # Training
    job = Job(config, named, source)
    write = place is not None
    place = None if str(place) == "auto" else place
    shows = []
    if progress:
        shows = [Notebook() if "ipykernel" in sys.modules else Terminal()]
    job.train(with_tracker(config.logger, shows), listeners, write=write, place=place)
    return TrainedRun.of(job)


def _dotted(given: Mapping[str, Any]) -> Iterator[str]:
    """Flatten settings to a dictionary by dotted name, leaving out nested values that are the default."""
    for name, value in given.items():
        yield name
        if isinstance(value, Mapping):
            yield from (f"{name}.{key}" for key in value)
        elif isinstance(value, Settings):
            yield from (f"{name}.{key}" for key, own in vars(value).items() if own != getattr(type(value)(), key))


@in_words
def evaluate(
    policies: Any,
    task: str | TaskSpec | None = None,
    design: Any = None,
    *,
    episodes: int = 32,
    checkpoint: str = "best",
    stochastic: bool = False,
    protocol: Literal["nominal", "noise", "sticky", "start", "sensors", "robust"] = "nominal",
    seed: int = 1000,
    level: float = 0.95,
    obs: str | None = None,
    policy: str | None = None,
    output_dir: str | Path = "outputs",
    **options: Unpack[PlayKeywords],
) -> PolicyTable:
    """Run whole episodes of policies and return their mean returns with confidence intervals.

    Args:
        policies: one or several: names of runs (folders, checkpoints, ``latest``, patterns, ``zoo:Walker-v0``), what
            :func:`warpvox.zoo`, :func:`warpvox.train` or :func:`warpvox.codesign` has returned (its best design, or one
            of its designs), or functions of observations, such as torch modules; what :func:`warpvox.load_policy`
            gives is run in float64, as runs are.
        task: of functions, unless they are policies that know theirs; for a run with a task of your own, this task.
        design: of functions; for runs over many bodies those to evaluate on; None: those held out. Beside functions,
            runs of one body leave it aside, as they do ``task``.
        episodes: of each policy, a multiple of its number of bodies.
        checkpoint: of runs.
        stochastic: of runs: sample actions as in training; of functions: they act at random, so that episodes differ.
        protocol: ``nominal``; or disturbed episodes: ``noise`` on actions, ``sticky`` actions, ``start`` with random
            actions, ``sensors`` with noise on observations; ``robust``: all of them, a row each.
        seed: of the random numbers of episodes and disturbances, and of sampled actions.
        level: of the intervals.
        obs: what functions observe, see :func:`warpvox.make_vec`.
        policy: of runs with a network of your own, where its code is, see :func:`warpvox.load_policy`.
        output_dir: where ``latest`` is looked for.
        options: ``device``, ``dtype``, ``arithmetic``, ``threads``, ``memory_check``; runs, and policies that know
            theirs, have a ``dtype`` and ``arithmetic`` of their own.

    Raises:
        RunError: no such run. ConfigError: a function without a task, an unknown option or value. WarpvoxError: as
            :func:`warpvox.make_vec`.
    """
    from warpvox.algos.find import find_runs, matches
    from warpvox.algos.protocols import NOMINAL, parts_of
    from warpvox.algos.settings import physics_of
    from warpvox.algos.training.bodies import load_bodies
    from warpvox.algos.training.loading import find_policy
    from warpvox.algos.training.playing import Playing, check_episodes, disturbed
    from warpvox.algos.training.policy_table import EvaluatedPolicy, PolicyTable, evaluate_run
    from warpvox.algos.training.settings import Training
    from warpvox.batch.options import SimOptions
    from warpvox.code import Code, is_code
    from warpvox.configs.show import EvaluateConfig
    from warpvox.devices.names import resolve_device
    from warpvox.devices.startup import own_torch
    from warpvox.envs.registry import get_task
    from warpvox.envs.vec_env import make_vec
    from warpvox.runs import Run

    check_known(options, evaluate, Playing, without=("num_envs",))
    EvaluateConfig(stochastic=stochastic, episodes=episodes, protocol=protocol, seed=seed, level=level)  # checks them
    ones = policies if isinstance(policies, Sequence) and not isinstance(policies, str) else [policies]
    if not ones:
        raise ConfigError("There are no policies: policies=[] names none.")
    own = Code(task) if is_code(task) else task
    network = Code(policy) if is_code(policy) else policy
    how = Playing(episodes, checkpoint, stochastic, seed, task=own, policy=network, protocol=protocol, **options)
    rows = []
    with own_torch(1):
        # What is named: runs and stored robots, or functions
        found: list[list[Run] | Callable[[Any], Any]] = []
        for one in ones:
            if isinstance(one, str) and matches(one) is not None:
                found.append(find_runs([one], str(output_dir)))
            else:
                policy_found = find_policy(one, output_dir, network)
                found.append([policy_found] if isinstance(policy_found, Run) else policy_found)
        beside = any(map(callable, found))  # task and design are theirs

        for number, one in enumerate(found):
            # Runs and stored robots
            if isinstance(one, list):
                if isinstance(own, str) and not (beside or isinstance(own, Code)):
                    raise ConfigError(f"task={own!r} goes with functions, or is the code of a run's own task.")
                for run in one:
                    rows.extend(evaluate_run(run, how, None if beside and not run.is_many else design, level))
                continue

            # Functions of observations
            about: Mapping[str, Any] = getattr(one, "metadata", {})
            where = own or about.get("task")
            body = about.get("design") if design is None else design
            if where is None or body is None:
                what = "a run, or a function of observations with task=... and design=..."
                raise ConfigError(f"Policy {number} must be {what}; got {ones[number]!r:.80}.")
            names = ("rules", "physics", "dtype", "arithmetic")
            known = Training.of({key: about[key] for key in names if about.get(key) is not None})
            known = dataclasses.replace(known, arithmetic=None) if options.get("dtype") else known
            sim = {"dtype": known.dtype, "arithmetic": known.arithmetic, "physics": physics_of(known)}
            if resolve_device(options.get("device") or SimOptions.device, episodes) == "cpu":
                sim["lanes"] = about.get("lanes")
            sim |= {key: value for key, value in options.items() if value is not None}
            bodies = load_bodies(body, seed)
            spec = getattr(one, "spec", None)
            if layout := (getattr(spec, "voxels", None) or {}).get("layout"):
                grid = layout["rows"], layout["columns"]
                if any(getattr(each, "shape", grid) != grid for each in bodies):
                    sim["grid"] = grid
            given: dict[str, Any] = {"rules": known.rules, "obs": obs or about.get("obs") or "task"} | sim
            parts = parts_of(protocol, feedback=getattr(spec, "has_feedback", True))
            if hasattr(one, "in_float64"):
                if stochastic:
                    raise ConfigError(f"stochastic=True samples actions of runs; policy {number} acts without chance.")
                one = one.in_float64()
            check_episodes(episodes, len(bodies))  # before make_vec counts environments
            count = episodes
            seeds = seed
            if about.get("seed_each"):  # as stored robots are evaluated
                count = 1 if parts == (NOMINAL,) and not get_task(where).is_random else episodes
                seeds = list(range(seed, seed + count)) * len(parts)
            if design is None and about.get("connections") is not None:
                given["connections"] = [about["connections"]]
            env = make_vec(where, bodies, count * len(parts), seed=seeds, auto_reset=False, **given)
            name = getattr(one, "__name__", f"policy {number}")
            rows.extend(EvaluatedPolicy.each(name, env, disturbed(one, env, parts, seed), level, parts, stochastic))
    return PolicyTable(rows)


@in_words
def record(
    env: Any,
    policy: Any = "sine",
    num_steps: int | None = None,
    *,
    metadata: Mapping[str, Any] | None = None,
) -> Rollout:
    """Record one episode of ``policy`` in every environment of ``env``, beginning with a reset.

    An environment whose episode ends stays as it ended until the recording is over, whatever ``env.auto_reset`` says
    (an environment that resets itself is left reset).

    Args:
        env: what :func:`warpvox.make_vec` makes.
        policy: ``function(obs)`` giving actions ``[num_envs, num_actions]`` in [0.6, 1.6]; whatever
            :func:`warpvox.load_policy` takes, which is run in float64; or ``sine``, ``random`` or ``zero``, which
            follow ``env.seed``.
        num_steps: at most so many control steps; None: until all episodes have ended.
        metadata: JSON values to keep with the rollout, for instance the configuration of a run.

    Raises:
        ConfigError: an unknown agent, a number of steps below 1, environments of another kind (gymnasium's), or a
            policy for other observations. RunError: no such run. ActionError: what the policy gives is refused.
    """
    from warpvox.runs import ZOO
    from warpvox.view.rollout import AGENTS, record

    if not isinstance(policy, str):
        is_agent = False
    elif policy in AGENTS:
        is_agent = True
    else:  # another name is a misspelt agent
        is_agent = not (policy == "latest" or policy.startswith(ZOO) or Path(policy).expanduser().exists())
    if is_agent:
        return record(env, policy, num_steps, metadata=metadata)

    from warpvox.algos.training.loading import load_policy

    act = load_policy(policy, device=str(getattr(env, "device", "cpu")))
    return record(env, act, num_steps, metadata=metadata)
