"""Registers, spills, stack and shared memory of the step kernels, from NVIDIA's assembler: no GPU is needed."""

import pytest
from ptxas import ARCHITECTURES, REGISTERS, SHARED, Limits, assemble, blocks, find_program

from warpvox.errors import WarpvoxError
from warpvox.kernels import group
from warpvox.kernels.step import step_kernel

WARPS = {80: 11, 89: 7, 90: 16, 100: 16, 120: 7}
"""Warps of walkers on a multiprocessor, by compute capability: two environments each."""
WALKER, CARRIER, BEAM = (36, 36, 104, 8), (48, 48, 133, 32), (69, 69, 196, 88)
CLIMBER, TRAVERSER = (336, 146, 289, 8), (344, 344, 850, 628)
FULL = {15: (256, 256, 930, 240), 25: (676, 676, 2550, 580), 35: (1296, 1296, 4970, 1220)}
"""Points, points that move, springs, and sides of rigid voxels; those of full bodies by the voxels of a side."""
BLOCK_SHARED = 48 * 1024
LARGE = [(90, 25, 256), (80, 25, 256), (100, 25, 256), (100, 35, 512), (89, 25, 32), (120, 25, 32)]
"""Compute capability, voxels of a side, threads of an environment."""
OLDER = {80: 32, 89: 80}
"""Bytes that a thread of a small group may spill on older generations."""
LANES = Limits(registers=255, stack=512, spilled=640, shared=0)
"""One thread an environment: what it keeps is in memory anyway."""


@pytest.fixture
def assembler():
    try:
        find_program()
    except WarpvoxError as missing:
        pytest.skip(str(missing))


needs_assembler = pytest.mark.usefixtures("assembler")


def choose(sizes, precision, **room):
    names = ("point", "mover", "spring", "rigid")
    return group.choose(dict(zip(names, sizes, strict=True)), precision, "cuda:0", **room)


def limits_of(sizes, precision, architecture, folder):
    chosen = choose(sizes, precision)
    return assemble(group.group_kernel(chosen), architecture, folder), chosen.registers


def check_group(found, most, architecture):
    few = OLDER.get(architecture, 0)
    assert found.spilled <= few
    assert found.stack <= few
    assert found.registers <= most
    assert 0 < found.shared <= BLOCK_SHARED


@needs_assembler
@pytest.mark.parametrize(
    "architecture", [a if a == 90 else pytest.param(a, marks=pytest.mark.slow) for a in ARCHITECTURES]
)
def test_a_walker_needs_no_memory_but_registers_and_shared_memory(architecture, tmp_path):
    found, most = limits_of(WALKER, "float32", architecture, tmp_path)
    check_group(found, most, architecture)
    assert blocks(found, architecture) == WARPS[architecture]


@needs_assembler
@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("sizes", [WALKER, CARRIER, (48, 48, 144, 32), BEAM])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_other_groups_neither(architecture, sizes, precision, tmp_path):
    check_group(*limits_of(sizes, precision, architecture, tmp_path), architecture)


@needs_assembler
@pytest.mark.slow
@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("sizes", [CLIMBER, TRAVERSER])
def test_several_warps_of_a_large_world_spill_next_to_nothing(architecture, sizes, tmp_path):
    found, most = limits_of(sizes, "float32", architecture, tmp_path)
    assert found.spilled <= 176
    assert found.stack <= 32
    assert found.registers <= most
    assert found.shared <= BLOCK_SHARED


@needs_assembler
@pytest.mark.parametrize(
    ("architecture", "side", "parts"), [(90, 35, 512), *(pytest.param(*case, marks=pytest.mark.slow) for case in LARGE)]
)
def test_large_bodies_ask_for_shared_memory_and_spill_little(architecture, side, parts, tmp_path):
    room = (SHARED[architecture] - 1) * 1024
    chosen = choose(FULL[side], "float32", room=room)
    assert chosen.parts == parts
    found = assemble(group.group_kernel(chosen), architecture, tmp_path)
    assert found.asked == chosen.bytes
    assert found.asked + found.shared <= room
    assert found.registers * parts <= REGISTERS
    if parts > group.WARP:  # else loops are not unrolled
        assert found.spilled <= 196
        assert found.stack <= 48


@needs_assembler
@pytest.mark.slow
@pytest.mark.parametrize(("arithmetic", "precision"), [("fast", "float32"), ("fast", "float64"), ("exact", "float64")])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_one_thread_an_environment(architecture, arithmetic, precision, tmp_path):
    found = assemble(step_kernel(arithmetic, precision, 1), architecture, tmp_path)
    for name, most in vars(LANES).items():
        assert name == "shared" or getattr(found, name) <= most, (name, found)
