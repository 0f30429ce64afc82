"""Registers, spills, stack and shared memory of the step kernels, from NVIDIA's assembler: no GPU is needed."""

import pytest

from warpvox.bench.cuda import SHARED, instructions
from warpvox.bench.ptxas import ARCHITECTURES, FETCHED, Limits, assemble, find_program
from warpvox.envs.vec_env import make_vec
from warpvox.errors import WarpvoxError
from warpvox.kernels import group
from warpvox.kernels.step import step_kernel
from warpvox.simulation import Simulation

INSTRUCTIONS = 1300
"""Warp instructions of Walker-v0, an environment and sub-step (3,660 with one thread an environment)."""
WALKER, FULL, CARRIER, BEAM, TRAVERSER = (36, 104), (40, 112), (45, 124), (69, 196), (344, 850)
BLOCK_SHARED = 48 * 1024
LANES = Limits(registers=255, stack=512, spilled=640, shared=0)
"""One thread an environment: what it keeps is in memory anyway."""


@pytest.fixture
def assembler():
    try:
        find_program("ptxas")
    except WarpvoxError as missing:
        pytest.skip(str(missing))


needs_assembler = pytest.mark.usefixtures("assembler")


def limits_of(sizes, precision, architecture, folder):
    chosen = group.choose(*sizes, precision, "cuda:0")
    return assemble(group.group_kernel(chosen), architecture, folder), chosen.registers


def check_group(found, most):
    assert found.spilled == 0
    assert found.stack == 0
    assert found.registers <= most
    assert 0 < found.shared <= BLOCK_SHARED


def test_the_assembler_is_looked_for_where_make_puts_it(repository):
    assert repository / "build" / "ptxas" / "nvidia" == FETCHED


@pytest.mark.parametrize(("release", "taken"), [("12.0", False), ("99.1", True)])
def test_an_assembler_on_the_path_that_is_too_old_is_not_taken(release, taken, tmp_path, monkeypatch):
    monkeypatch.setattr("warpvox.bench.ptxas.FETCHED", tmp_path)
    program = tmp_path / "ptxas"
    program.write_text(f"#!/bin/sh\necho Cuda compilation tools, release {release}, V{release}.1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    if taken:
        assert find_program("ptxas") == program
    else:
        with pytest.raises(WarpvoxError, match=r"is of CUDA 12\.0, older than that of Warp .*make ptxas"):
            find_program("ptxas")


@needs_assembler
@pytest.mark.parametrize(
    "architecture", [a if a in (80, 90) else pytest.param(a, marks=pytest.mark.slow) for a in ARCHITECTURES]
)
def test_a_walker_needs_no_memory_but_registers_and_shared_memory(architecture, tmp_path):
    found, most = limits_of(WALKER, "float32", architecture, tmp_path)
    check_group(found, most)
    # by registers 8 warps of 4 environments are on a multiprocessor; the shared memory has room for them, or for 4
    assert found.shared * (8 if architecture in (90, 100) else 4) <= SHARED[architecture] * 1024


@needs_assembler
def test_a_walker_takes_few_instructions():
    env = make_vec("Walker-v0", num_envs=1, device="cpu", dtype="float32", lanes=1, threads=1)
    sim = Simulation([env.sim.worlds[0]] * 4, env.sim.options, layout="group", lanes=None)
    found = instructions(sim, steps=10, seed=0)
    every = sum(count for count, _ in found.values())
    assert all(0 <= double <= count for count, double in found.values())
    assert found["springs: three Runge-Kutta stages"][1] == 0  # springs are in float32
    assert 0.5 * INSTRUCTIONS < every <= INSTRUCTIONS


@needs_assembler
@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("sizes", [WALKER, FULL, CARRIER, BEAM])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_other_groups_neither(architecture, sizes, precision, tmp_path):
    check_group(*limits_of(sizes, precision, architecture, tmp_path))


@needs_assembler
@pytest.mark.slow
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_large_world_has_what_its_threads_own_in_local_memory(architecture, tmp_path):
    found, _ = limits_of(TRAVERSER, "float32", architecture, tmp_path)
    assert found.spilled == 0
    assert found.stack <= 2048
    assert found.shared <= BLOCK_SHARED


@needs_assembler
@pytest.mark.slow
@pytest.mark.parametrize(("arithmetic", "precision"), [("fast", "float32"), ("fast", "float64"), ("exact", "float64")])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_one_thread_an_environment(architecture, arithmetic, precision, tmp_path):
    found = assemble(step_kernel(arithmetic, precision, 1), architecture, tmp_path)
    for name, most in vars(LANES).items():
        assert name == "shared" or getattr(found, name) <= most, (name, found)
