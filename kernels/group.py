"""The control step with a group of threads per environment, for CUDA: its state stays on the chip all the while.

The physics is that of the stages of ``step.py`` in fast arithmetic, in one launch; the C++ is in ``native/group``.
Packs have one lane, so that the rows of an environment lie side by side and each may have tables of its own. The
threads of a group take points, springs and candidates in turns (``for (i = part; i < n; i += parts)``); sums are
made in a fixed order by one thread, and what is atomic, the marking of pairs, is the same in any order: the bits of an
environment do not depend on the rest of the batch.

On the CPU the same source runs in Warp's cooperative blocks, for tests. There, and in float64, it equals the lanes bit
for bit. In float32 on CUDA it is *approximate*: roots and quotients of springs and the contact law are accurate to a
few units in the last place of float32, positions and velocities are accumulated in float64 as everywhere.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import warp as wp

from warpvox.kernels.contact import DEGENERATE, PARALLEL
from warpvox.kernels.device import Command, on_cuda, record, register_limited
from warpvox.kernels.kit import kit_of
from warpvox.kernels.lanes import constants, text
from warpvox.kernels.state import CPP_CONSTANTS
from warpvox.types import VOXEL

WARP = 32
"""Threads of a CUDA block, or those of a larger group: the groups of a warp go the same way; more would only wait."""
SHARED_BYTES = 47 * 1024
"""Shared memory of the groups of a CUDA block, at most. A block has 48 KiB without asking, some of them Warp's."""
FEW = 9
"""Rounds of a loop over points or springs up to which it is unrolled (``native/group/base.h``). Where 32 threads need
more, 64 or 128 take an environment."""
LINKS = 8
"""Springs of a point, at most: in a lattice four sides and four diagonals of voxels meet in it."""
ROUNDS = 64
"""Turns of a loop over points, at most: a bit for each."""
CODED = 1 << 13
"""Candidates for contact whose corners can be listed: a code has 16 bits."""
CLOSE_MARGIN = 0.012
"""Distance from another voxel below which corners are tested in every sub-step, until a point has moved half of it."""


@dataclass(frozen=True)
class Group:
    """Sizes and options that a group kernel is compiled for.

    Attributes:
        precision: of the springs, 'float32' or 'float64'.
        parts: threads of a group: 16, 32, 64 or 128.
        points, movers, springs, rigids: capacities, multiples of 16 or 32; no other points than the first ``movers``
            are free or hang on a spring; rigids are the sides of rigid voxels.
        approximate: roots, quotients and the contact law in fast float32.
    """

    precision: str
    parts: int
    points: int
    movers: int
    springs: int
    rigids: int
    approximate: bool

    @property
    def registers(self) -> int:
        """Registers of a thread, at most.

        In float32 next to nothing spills, and each quarter of a multiprocessor, which has registers of its own, has
        room for 4 warps (of 144 for 3). float64 takes all that there are.
        """
        if self.precision == "float64":
            return 255
        return 144 if self.parts == 64 else 128

    @property
    def layout(self) -> dict[str, tuple[int, int]]:
        """Elements of each field of ``Shared`` (``native/group/base.h``), and the bytes of one.

        Tensions of springs share their place with others. The list of close corners has room for 8 a thread.
        """
        real, movers, springs, parts = 4 if self.precision == "float32" else 8, self.movers, self.springs, self.parts
        touch = 16 * movers + min(parts, WARP) * (16 + 12 * real) + 16 * parts
        in_turn = max(touch, 2 * real * (springs + 2), 2 * real * movers)
        fields = dict(pos=(self.points, 16), disp=(movers, 2 * real), contact=(movers, 2 * real), links=(movers, 16))
        fields |= dict(spring=(springs, 2 * real), length=(springs, 2 * real), rigid=(self.rigids, 2 * real))
        fields |= dict(tension=(in_turn // (2 * real), 2 * real))
        return fields | dict(close=(8 * parts, 2))

    @property
    def bytes(self) -> int:
        """Memory that the threads of a group share."""
        return sum(count * size for count, size in self.layout.values())

    @property
    def row(self) -> int:
        """Numbers of 8 bytes that a group has on the CPU: this memory and that of votes."""
        return (self.bytes + 4 * max(WARP, self.parts)) // 8


def choose(sizes: Mapping[str, int], precision: str, device: str) -> Group | None:
    """The group for worlds of such sizes; None where they exceed the shared memory.

    Args:
        sizes: the most points ('point'), springs ('spring') and sides of rigid voxels ('rigid'); no other points than
            the first 'mover' are free or hang on a spring.
    """
    counts = [sizes[name] for name in ("point", "mover", "spring", "rigid")]
    points, movers, springs, _ = counts
    if on_cuda(device):
        # 16 threads for bodies of 5 x 5 voxels, with a box or a ball; else as many as keep loops unrolled
        if movers <= 48 and springs <= 144:
            tried = [16, WARP]
        else:
            rounds = math.ceil(max(movers, springs) / FEW)
            tried = [next((parts for parts in (WARP, 2 * WARP) if rounds <= parts), 4 * WARP), WARP]
    else:
        # One kernel for most worlds, as memory is no limit there
        points = max(points, 512)
        counts = [points, points, max(springs, 1024), max(counts[-1], 1024)]
        tried = [16 if points <= 16 * ROUNDS else 32]

    for parts in tried:
        unit = min(parts, WARP)
        room = [math.ceil(max(count, 1) / unit) * unit for count in counts]
        group = Group(precision, parts, *room, on_cuda(device) and precision == "float32")
        fits = group.movers <= ROUNDS * parts and group.springs < 1 << 15  # point and place numbers have 16 bits
        if fits and (not on_cuda(device) or group.bytes * max(WARP // parts, 1) <= SHARED_BYTES):
            return group
    return None


def source(group: Group, whole_warps: bool = False) -> str:
    """The C++ of a group kernel; with ``whole_warps`` the groups of a warp are one block on the CPU, too."""
    sizes = dict(PARTS=group.parts, POINTS=group.points, MOVERS=group.movers, SPRINGS=group.springs, LINKS=LINKS)
    sizes |= dict(RIGIDS=group.rigids, GROUP_BYTES=group.bytes, FEW=FEW, CODED=CODED, CLOSE=group.layout["close"][0])
    sizes |= CPP_CONSTANTS | dict(VOXEL=VOXEL, PARALLEL=PARALLEL, DEGENERATE=DEGENERATE, CLOSE_MARGIN=CLOSE_MARGIN)
    sizes |= dict(SHARED_BYTES=SHARED_BYTES, WHOLE_WARPS=int(whole_warps))
    lines = [f"typedef {'float' if group.precision == 'float32' else 'double'} Real;"]
    lines += [f"typedef unsigned {'long long' if group.movers > 32 * group.parts else 'int'} Bits;"]
    lines += [f"#define APPROXIMATE {int(group.approximate)}"]
    lines += [constants(**sizes)]
    shared = [f"native/{name}.h" for name in ("tanh", "triangles", "crossing", "forces", "contact_law")]
    own = [f"native/group/{name}.h" for name in ("load", "candidates", "contact", "move", "limit", "step")]
    lines += [text("native/pairs.h", "native/group/base.h", *shared, *own)]
    lines += ["#undef APPROXIMATE\n"]
    return "\n".join(lines)


@functools.cache
def group_kernel(group: Group, whole_warps: bool = False) -> wp.Kernel:
    """The kernel; launch over (rows, parts), whole warps, whatever the number of packs.

    ``order`` permutes the threads, which on the CPU must change nothing.
    """
    kit = kit_of(group.precision, 1)

    @wp.func_native(source(group, whole_warps))
    def control_step(
        model: kit.Model, data: kit.Data, scratch: wp.array2d(dtype=wp.float64), mesh: int, pack: int, part: int,
        live: int, substeps: int, dt: wp.float64,
    ): ...  # fmt: skip

    @register_limited(group.registers, max(WARP, group.parts))
    def group_step(
        model: kit.Model, data: kit.Data, scratch: wp.array2d(dtype=wp.float64), first_pack: int, packs: int,
        order: int, substeps: int, dt: wp.float64,
    ):  # fmt: skip
        row, thread = wp.tid()
        pack = first_pack + wp.min(row, packs - 1)
        live = wp.where(row < packs, 1, 0)
        control_step(model, data, scratch, model.pack_mesh[pack], pack, thread ^ order, live, substeps, dt)

    return group_step


def record_group(state, substeps: int, first: int, packs: int, order: int = 0) -> wp.Launch | Command:
    """A command that does one control step of the packs ``first`` to ``first + packs`` from the actions taken."""
    group = state.group
    inputs = [state.model, state.data, state.scratch, first, packs, order, substeps, state.dt]
    block, together = max(WARP if on_cuda(state.device) else 1, group.parts), max(WARP // group.parts, 1)
    rows = -(-packs // together) * together
    return record(group_kernel(group), (rows, group.parts), inputs, state.device, block, together=True)
