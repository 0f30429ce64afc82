"""The figures of ``warpvox bench suite=gpu``: speeds by size and block, stages, bodies, training."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from warpvox.algos.env_factory import Arena
from warpvox.algos.population.training import PopulationTraining
from warpvox.batch.options import CUDA_LANES
from warpvox.bench.bodies import full_body, one_body
from warpvox.bench.kernels import STAGES, stage_times
from warpvox.bench.launches import Launches
from warpvox.bench.learning import learn
from warpvox.bench.machine import available_memory
from warpvox.bench.memory import per_environment
from warpvox.bench.mixed import rates, sampled
from warpvox.bench.predictions import KERNEL, predicted
from warpvox.bench.progress import Progress
from warpvox.bench.report import middle, number
from warpvox.bench.subject import LOADING, Subject, clock, measure
from warpvox.configs.presets import training_preset
from warpvox.envs.vec_env import make_vec
from warpvox.kernels.device import BLOCK
from warpvox.kernels.step import record_step

__all__ = ["bodies", "learning", "sizes", "stages", "tasks", "training"]

LAUNCHES = 3
LEARNING_SECONDS = 60.0
"""What learning may take at the most."""
POPULATION_STEPS = 16
"""Control steps of an iteration of the population's training that is timed."""


def sizes(config: Any, progress: Progress, counts: tuple[int, ...], blocks: tuple[int, ...], graph: bool) -> None:
    """The physics alone by block, and whole steps, by the number of environments; predictions beside them."""
    part, body, needed = "sizes, graph" if graph else "sizes", one_body(config), 0.0
    rows, kernels = [], []
    for count in counts:
        if not progress.time_for(f"{part}: {count:,} environments") or not _fits(config, progress, count, needed):
            continue
        before = available_memory(config.device)
        subject = Subject(config, config.task, body, count, cuda_graph=graph)
        subject.settle()
        taken, needed = before - available_memory(config.device), per_environment(subject.env)
        physics = {} if graph or subject.env.sim.layout == "lanes" else {KERNEL: _physics(subject)}
        if blocks:
            of_lanes = subject if not physics else Subject(config, config.task, body, count, lanes=CUDA_LANES)
            of_lanes.timed("step", LOADING)
            physics |= {f"block {block}": _physics(of_lanes, block) for block in blocks}
        step = middle(measure(subject, ["step"], config.repeats)["step"])
        told = predicted(config.task, config.dtype, count)
        shown = ", ".join(f"{number(rate / 1e6)} M ({kernel})" for kernel, rate in physics.items())
        rows.append([f"{count:,}", *(number(rate) for rate in physics.values()), told, number(step)])
        kernels = [f"physics, {kernel}" for kernel in physics]
        progress.row(
            part, f"{count:,} environments: {shown or 'graph'}; predicted {told}; whole steps {number(step / 1e6)} M",
            num_envs=count, physics=physics, predicted=told, step=step, bytes=needed, taken=taken,
        )  # fmt: skip
    launched = ", one graph a step" if graph else ""
    title = (
        f"{config.task}, control steps per second, {config.dtype}, {config.device}{launched}; predicted for {KERNEL}"
    )
    progress.report.table(title, ["environments", *kernels, "predicted", "step only"], rows)


def _fits(config: Any, progress: Progress, count: int, needed: float) -> bool:
    """Whether environments of ``needed`` bytes each fit into what is free; a note says it if they do not."""
    fits = count * needed <= available_memory(config.device)
    if not fits:
        progress.report.note(f"{count:,} environments need {count * needed / 2**30:.1f} GiB: left out.")
    return fits


def _physics(subject: Subject, block: int = BLOCK) -> float:
    """Control steps per second of the step's kernel alone; with one thread an environment in blocks of so many."""
    sim = subject.env.sim
    command = record_step(sim.buffers, sim.physics.substeps, 0, sim.buffers.packs, block)
    command.launch()
    began = clock(subject.device)
    for _ in range(LAUNCHES):
        command.launch()
    found = LAUNCHES * subject.num_envs / (clock(subject.device) - began)
    sim.forget_sensed()
    return found


def stages(config: Any, progress: Progress, count: int) -> None:
    """Each stage of the physics by itself."""
    lanes = {} if config.device == "cpu" else {"lanes": CUDA_LANES}  # a group goes through all stages at once
    subject = Subject(config, config.task, one_body(config), count, **lanes)
    subject.settle()
    times = stage_times(subject, config)
    total = sum(times.values()) or 1.0
    rows = [[STAGES.get(name, name), number(value), f"{value / total:.0%}"] for name, value in times.items()]
    for name, value in times.items():
        progress.row("stages", f"{name}: {number(value)} us", stage=name, microseconds=value)
    title = f"{count:,} environments: stages, microseconds per control step of an environment"
    progress.report.table(title, ["stage", "time", "share"], rows)


def bodies(config: Any, progress: Progress, count: int, sides: tuple[int, ...]) -> None:
    """A different body in every environment beside one in all, then full bodies of several sizes."""
    options = dict(device=config.device, dtype=config.dtype, arithmetic=config.arithmetic, threads=config.threads)
    designs = sampled(count, config.seed)
    began = clock(config.device)
    mixed = make_vec(config.task, designs, count, **options)
    built = clock(config.device) - began
    alone = make_vec(config.task, designs[:1], count, **options)
    different, same = map(middle, rates([mixed, alone], config.steps, config.repeats, config.seed))
    text = f"{count:,} different bodies: {number(different)} steps/s, {different / same:.0%} of one in all"
    progress.row(
        "bodies", f"{text}; built in {built:.2f} s", num_envs=count, different=different, same=same, built=built
    )
    progress.report.note(f"{text}; built in {built:.2f} s.")
    rows = []
    for side in sides:
        if not progress.time_for(f"bodies: {side} x {side}"):
            continue
        subject = Subject(config, config.task, full_body(side, config.seed), count)
        subject.settle()
        rate = middle(measure(subject, ["step"], config.repeats)["step"])
        size = per_environment(subject.env)
        progress.row("bodies", f"full {side} x {side}: {number(rate)} steps/s", side=side, rate=rate, bytes=size)
        rows.append([f"{side} x {side}", number(rate), number(rate * side**2)])
    title = f"Full bodies, {count:,} environments, control steps per second"
    progress.report.table(title, ["body", "steps/s", "voxel steps/s"], rows)


def training(config: Any, progress: Progress, counts: tuple[int, ...], designs: int) -> None:
    """Whole iterations of PPO, and of a population of designs that are trained side by side."""
    rows = []
    for count in counts:
        if not progress.time_for(f"training: {count:,} environments"):
            continue
        subject = Subject(config, config.task, one_body(config), count)
        subject.settle()
        found = {name: middle(values) for name, values in measure(subject, ["step", "training"], 1).items()}
        with Launches() as launches:
            subject.timed("training", 1)
        sums = {"operations": launches.operations, "kernels": launches.kernels, "waits": sum(launches.waits.values())}
        progress.row(
            "training",
            f"{count:,} environments: {number(found['training'])} steps/s; an iteration has {sums['operations']:,}"
            f" operations of torch, {sums['kernels']} kernels of Warp, {sums['waits']} waits of the host",
            num_envs=count, **found, **sums,
        )  # fmt: skip
        rows.append([f"{count:,}", number(found["step"]), number(found["training"])])
    progress.report.table("Control steps per second", ["environments", "step only", "with training"], rows)
    if not progress.time_for("training: population"):
        return
    settings = training_preset("paper_wide", {"steps": POPULATION_STEPS})
    precision = dict(dtype=config.dtype, arithmetic=config.arithmetic)
    arena = Arena(config.task, device=config.device, threads=config.threads, **precision)
    population = PopulationTraining(arena, sampled(designs, config.seed), list(range(designs)), settings)
    population.iterate()  # loads the kernels
    began = time.perf_counter()
    population.iterate()
    rate = designs * settings.envs * POPULATION_STEPS / (time.perf_counter() - began)
    text = f"{designs} designs of {settings.envs} environments side by side: {number(rate)} steps/s with training"
    progress.row("training", text, designs=designs, envs=settings.envs, rate=rate)
    progress.report.note(f"{text}.")


def learning(config: Any, progress: Progress) -> None:
    """How long it takes to the return that the configuration names."""
    seconds = min(config.learning.seconds, LEARNING_SECONDS, max(progress.left, 1.0))
    config = replace(config, learning=replace(config.learning, seconds=seconds))
    found = learn(config, one_body(config), config.learning.ppo[0], config.seed)
    took = f"{found['seconds']:.1f} s" if found["seconds"] is not None else "not reached"
    text = (
        f"ppo={config.learning.ppo[0]}, {found['num_envs']} environments: return {config.learning.stop_return:g}"
        f" {took}, {found['steps']:,} control steps"
    )
    progress.row("learning", text, **found)
    progress.report.note(f"{text}.")


def tasks(config: Any, progress: Progress, names: list[str], count: int) -> None:
    """The speed of every task."""
    body, rows = one_body(config), []
    for task in names:
        if not progress.time_for(f"tasks: {task}"):
            continue
        subject = Subject(config, task, body, count)
        subject.settle()
        rate = middle(measure(subject, ["step"], config.repeats)["step"])
        progress.row("tasks", f"{task}: {number(rate)} steps/s", task=task, rate=rate)
        rows.append([task, number(rate)])
    progress.report.table(f"{count:,} environments, control steps per second", ["task", "step only"], rows)
