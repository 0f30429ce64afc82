"""The figures of ``warpvox bench suite=gpu``: speeds by size, bodies, training."""

import time
from dataclasses import replace
from typing import Any

from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.population.training import PopulationTraining
from warpvox.batch.options import SimOptions
from warpvox.bench.cases import full_body, one_body, sampled_bodies
from warpvox.bench.learning import learn
from warpvox.bench.machine import per_environment
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import Runner, measure, seconds
from warpvox.configs.composition import training_preset
from warpvox.devices.out_of_memory import free_memory
from warpvox.errors import MemoryLimitError
from warpvox.kernels.step import record_step
from warpvox.system import usable_cores

LAUNCHES = 3
MOST_ON_CPU = 4096
"""Environments up to which the CPU is measured beside the device."""
LEARNING_SECONDS = 60.0
"""Seconds that learning may take at the most."""
POPULATION_STEPS = 16
"""Control steps of an iteration of the population's training that is timed."""


def _runner(config: Any, count: int, task: str | None = None, body: Any = None, **options: Any) -> Runner:
    """Environments of one body. What they compute is compared in the parts before."""
    body = one_body(config) if body is None else body
    return Runner(config, [body], count, task, checked=False, **options)


def _median(runner: Runner, config: Any) -> float:
    """Control steps per second, random actions."""
    return middle(measure({"": runner}, ["step"], config.repeats)[""]["step"])


def sizes(config: Any, report: Report, counts: tuple[int, ...]) -> None:
    """The physics alone, whole steps as a graph, the same launched one by one, and on all cores of the CPU."""
    rows, cpu = [], replace(config, device="cpu", threads=usable_cores())
    for count in report.in_time("sizes", counts, "{:,} environments"):
        before = free_memory(config.device) or 0
        try:
            runner = _runner(config, count)
        except MemoryLimitError as error:
            report.note(f"Left out: {error}")
            continue
        taken = before - (free_memory(config.device) or 0)
        physics, step = _physics(runner), _median(runner, config)
        single = beside = None
        if config.device != "cpu":
            single = _median(_runner(config, count, cuda_graph=False), config)
            beside = _median(_runner(cpu, count, now=time.perf_counter), cpu) if count <= MOST_ON_CPU else None
        rows.append((count, f"{count:,}", physics, step, single, beside))
        report.row(
            "sizes",
            f"{count:,} environments: {number(physics / 1e6)} M (physics), {number(step / 1e6)} M (whole steps),"
            f" {number(single and single / 1e6)} M (without a graph), {number(beside and beside / 1e6)} M (CPU)",
            num_envs=count, layout=runner.env.sim.layout, physics=physics, step=step, single=single, cpu=beside,
            bytes=per_environment(runner.env), taken=taken,
        )  # fmt: skip
    title = f"{config.task}, control steps per second, {config.dtype}, {config.device}"
    headings = ["environments", "physics", "step only", "without a graph", f"step only, CPU, {cpu.threads} threads"]
    report.table(title, headings, [row[1:] for row in sorted(rows)])


def _physics(runner: Runner) -> float:
    """Control steps per second of the step's kernel alone."""
    sim = runner.env.sim
    command = record_step(sim.buffers, sim.physics.substeps, 0, sim.buffers.packs)
    command.launch()
    taken = seconds(lambda: [command.launch() for _ in range(LAUNCHES)], runner.env.device)
    sim.forget_sensed()
    return LAUNCHES * runner.num_envs / taken


def bodies(config: Any, report: Report, count: int, sides: tuple[int, ...]) -> None:
    """A different body in every environment beside one in all, then full bodies of several sizes."""
    designs = sampled_bodies(5, count, config.seed)
    mixed = Runner(config, designs, count, checked=False)
    runners = {"different": mixed, "same": _runner(config, count, body=designs[0])}
    found = measure(runners, ["step"], config.repeats)
    different, same, built = middle(found["different"]["step"]), middle(found["same"]["step"]), mixed.built
    text = f"{count:,} different bodies: {number(different)} steps/s, {different / same:.0%} of one in all"
    values = {"num_envs": count, "different": different, "same": same, "built": built}
    report.row("bodies", f"{text}; built in {built:.2f} s", noted=True, **values)
    rows = []
    for side in report.in_time("bodies", sides, "{0} x {0}"):
        runner = _runner(config, count, body=full_body(side, config.seed))
        rate, size = _median(runner, config), per_environment(runner.env)
        report.row("bodies", f"full {side} x {side}: {number(rate)} steps/s", side=side, rate=rate, bytes=size)
        rows.append([f"{side} x {side}", rate, rate * side**2])
    title = f"Full bodies, {count:,} environments, control steps per second"
    report.table(title, ["body", "steps/s", "voxel steps/s"], rows)


def training(config: Any, report: Report, counts: tuple[int, ...], designs: int, each: tuple[int, ...]) -> None:
    """Whole iterations of PPO, and of ``designs`` that are trained side by side in so many environments each."""
    rows = []
    for count in report.in_time("training", counts, "{:,} environments"):
        found = measure({"": _runner(config, count)}, ["step", "training"], 1)[""]
        rates: dict[str, Any] = {name: middle(values) for name, values in found.items()}
        text = f"{count:,} environments: {number(rates['training'])} steps/s with training"
        report.row("training", text, num_envs=count, **rates)
        rows.append([f"{count:,}", *rates.values()])
    report.table("Control steps per second", ["environments", "step only", "with training"], rows)
    sim = SimOptions(config.device, config.dtype, config.arithmetic, threads=config.threads)
    several = sampled_bodies(5, designs, config.seed), list(range(designs))
    for envs in report.in_time("training", each, f"{designs} designs of {{}} environments"):
        settings = training_preset("paper_wide", {"steps": POPULATION_STEPS}, envs=envs)
        population = PopulationTraining(EnvFactory(config.task, sim=sim), *several, settings)
        population.iterate()  # loads the kernels
        rate = designs * envs * POPULATION_STEPS / seconds(population.iterate, config.device)
        text = f"{designs} designs of {envs} environments side by side: {number(rate)} steps/s with training"
        report.row("training", text, noted=True, designs=designs, envs=envs, rate=rate)


def learning(config: Any, report: Report) -> None:
    """How long it takes to the return that the configuration names."""
    config = replace(config, seconds=min(LEARNING_SECONDS, max(report.left, 1.0)))
    found = learn(config, one_body(config), config.learning.ppo[0], config.seed)
    took = f"{found['seconds']:.1f} s" if found["seconds"] is not None else "not reached"
    text = f"ppo={config.learning.ppo[0]}, {found['num_envs']} environments: return {config.learning.stop_return:g}"
    report.row("learning", f"{text} {took}, {found['steps']:,} control steps", noted=True, **found)


def tasks(config: Any, report: Report, names: list[str], count: int) -> None:
    """The speed of every task."""
    rows = []
    for task in report.in_time("tasks", names):
        rate = _median(_runner(config, count, task), config)
        report.row("tasks", f"{task}: {number(rate)} steps/s", task=task, rate=rate)
        rows.append([task, rate])
    report.table(f"{count:,} environments, control steps per second", ["task", "step only"], rows)
