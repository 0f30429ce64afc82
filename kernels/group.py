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
"""Shared memory of the groups of a CUDA block that there is without asking: 48 KiB, some of them Warp's."""
FEW = {WARP: 9, 64: 9, 128: 9, 256: 10, 512: 10}
"""Threads that take an environment, and the rounds of a loop over points or springs up to which so many do."""
UNROLLED = 10
"""Rounds of such a loop up to which it is unrolled (``native/group/base.h``)."""
LINKS = 8
"""Springs of a point, at most: in a lattice four sides and four diagonals of voxels meet in it."""
STATIC_BYTES = 5
"""Shared memory of a block that is not the groups', a thread, at most: Warp's, and what warps vote with."""
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
        parts: threads of a group: 16 to 512.
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
        if self.precision == "float64" and self.parts <= 256:
            return 255
        return 144 if self.parts == 64 else 128

    @property
    def layout(self) -> dict[str, tuple[int, int]]:
        """Elements of each field of ``Shared`` (``native/group/base.h``), and the bytes of one.

        Tensions of springs share their place with others. The list of close corners has room for 8 a thread.
        """
        real = 4 if self.precision == "float32" else 8
        movers = self.movers
        springs = self.springs
        parts = self.parts
        touch = 16 * movers + min(parts, WARP) * (16 + 12 * real) + 16 * parts
        in_turn = max(touch, 2 * real * (springs + 2), 2 * real * movers)
        fields = dict(pos=(self.points, 16), disp=(movers, 2 * real), contact=(movers, 2 * real), links=(movers, 16))
        fields |= dict(spring=(springs, 2 * real), length=(springs, 2 * real), rigid=(self.rigids, 2 * real))
        fields |= dict(tables=(2, 16))
        fields |= dict(tension=(in_turn // (2 * real), 2 * real))
        return fields | dict(close=(8 * parts, 2))

    @property
    def bytes(self) -> int:
        """Memory that the threads of a group share."""
        return sum(count * size for count, size in self.layout.values())

    @property
    def large(self) -> bool:
        """True if the group's block has to ask CUDA for more shared memory than blocks have by default."""
        return self.approximate and self.bytes * max(WARP // self.parts, 1) > SHARED_BYTES

    @property
    def row(self) -> int:
        """Number of 8-byte values that a group needs on the CPU: its shared memory and the memory of votes."""
        return (self.bytes + 4 * max(WARP, self.parts)) // 8


def choose(sizes: Mapping[str, int], precision: str, device: str, room: int = SHARED_BYTES) -> Group | None:
    """Return the sizes of a group of threads for worlds of these sizes; None if none fits into the shared memory.

    Args:
        sizes: the most points ('point'), springs ('spring') and sides of rigid voxels ('rigid'); no other points than
            the first 'mover' are free or hang on a spring.
        room: bytes of shared memory that a block of the device may ask for. It counts in float32 alone.
    """
    counts = [sizes[name] for name in ("point", "mover", "spring", "rigid")]
    points, movers, springs, _ = counts
    if on_cuda(device):
        # 16 threads for bodies of 5 x 5 voxels, with a box or a ball; else as many as keep loops unrolled
        if movers <= 48 and springs <= 144:
            tried = [16, WARP]
        else:
            enough = [parts for parts, rounds in FEW.items() if max(movers, springs) <= rounds * parts]
            tried = [min(enough, default=max(FEW)), WARP]
    else:
        # One kernel for most worlds, as memory is no limit there
        points = max(points, 512)
        counts = [points, points, max(springs, 1024), max(counts[-1], 1024)]
        tried = [16 if points <= 16 * ROUNDS else 32]

    for parts in tried:
        unit = min(parts, WARP)
        capacities = [math.ceil(max(count, 1) / unit) * unit for count in counts]
        group = Group(precision, parts, *capacities, on_cuda(device) and precision == "float32")
        fits = group.movers <= ROUNDS * parts and group.springs < 1 << 15  # point and place numbers have 16 bits
        if group.large:
            fits &= group.bytes + STATIC_BYTES * parts <= room
        elif on_cuda(device):
            fits &= group.bytes * max(WARP // parts, 1) <= SHARED_BYTES
        if fits:
            return group
    return None


def source(group: Group, whole_warps: bool = False) -> str:
    """Return the C++ of a group kernel; with ``whole_warps`` the groups of a warp are one block on the CPU, too."""
    sizes = dict(PARTS=group.parts, POINTS=group.points, MOVERS=group.movers, SPRINGS=group.springs, LINKS=LINKS)
    sizes |= dict(
        RIGIDS=group.rigids, GROUP_BYTES=group.bytes, FEW=UNROLLED, CODED=CODED, CLOSE=group.layout["close"][0]
    )
    sizes |= CPP_CONSTANTS | dict(VOXEL=VOXEL, PARALLEL=PARALLEL, DEGENERATE=DEGENERATE, CLOSE_MARGIN=CLOSE_MARGIN)
    sizes |= dict(FEW=UNROLLED, SHARED_BYTES=SHARED_BYTES, WHOLE_WARPS=int(whole_warps))
    lines = [f"typedef {'float' if group.precision == 'float32' else 'double'} Real;"]
    lines += [f"typedef unsigned {'long long' if group.movers > 32 * group.parts else 'int'} Bits;"]
    lines += [f"#define APPROXIMATE {int(group.approximate)}", f"#define LARGE {int(group.large)}"]
    lines += [constants(**sizes)]
    shared = [f"native/{name}.h" for name in ("tanh", "triangles", "crossing", "forces", "contact_law")]
    own = [f"native/group/{name}.h" for name in ("load", "candidates", "contact", "move", "limit", "step")]
    lines += [text("native/pairs.h", "native/group/base.h", *shared, *own)]
    lines += ["#undef APPROXIMATE\n#undef LARGE\n"]
    return "\n".join(lines)


@functools.cache
def group_kernel(group: Group, whole_warps: bool = False) -> wp.Kernel:
    """Build the kernel of a control step; launch it over (rows, parts), where the rows fill whole warps.

    Rows beyond the number of packs compute nothing.

    ``order`` permutes the threads, which on the CPU must change nothing.
    """
    kit = kit_of(group.precision, 1)
    limited = register_limited(group.registers, max(WARP, group.parts))
    cpp = source(group, whole_warps)
    if group.large and not whole_warps:
        # Warp asks for the memory of tiles; the body finds the address of this one in `room`
        numbers = group.bytes // 8

        @wp.func_native(cpp)
        def large_step(
            model: kit.Model, data: kit.Data, scratch: wp.array2d(dtype=wp.float64), mesh: int, pack: int, part: int,
            live: int, substeps: int, dt: wp.float64, room: wp.tile(dtype=wp.float64, shape=(numbers,)),
        ): ...  # fmt: skip

        @limited
        def group_step(
            model: kit.Model, data: kit.Data, scratch: wp.array2d(dtype=wp.float64), first_pack: int, packs: int,
            order: int, substeps: int, dt: wp.float64,
        ):  # fmt: skip
            row, thread = wp.tid()
            pack = first_pack + wp.min(row, packs - 1)
            live = wp.where(row < packs, 1, 0)
            room = wp.tile_zeros(shape=numbers, dtype=wp.float64, storage="shared")
            large_step(model, data, scratch, model.pack_mesh[pack], pack, thread ^ order, live, substeps, dt, room)

        return group_step

    @wp.func_native(cpp)
    def control_step(
        model: kit.Model, data: kit.Data, scratch: wp.array2d(dtype=wp.float64), mesh: int, pack: int, part: int,
        live: int, substeps: int, dt: wp.float64,
    ): ...  # fmt: skip

    @limited
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
    """Record one control step of the packs ``first`` to ``first + packs``; return the command that launches it.

    The step reads the actions that are in the buffers when the command is launched. ``order`` is explained under
    :func:`group_kernel`.
    """
    group = state.group
    inputs = [state.model, state.data, state.scratch, first, packs, order, substeps, state.dt]
    threads = max(WARP if on_cuda(state.device) else 1, group.parts)

    # One row of threads for each pack, rounded up so that every warp is full of groups
    groups_per_warp = max(WARP // group.parts, 1)
    rows = math.ceil(packs / groups_per_warp) * groups_per_warp
    return record(group_kernel(group), (rows, group.parts), inputs, state.device, threads, together=True)
