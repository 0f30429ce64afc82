"""Wavefronts of shared memory: the cycles for which the accesses of a warp occupy it.

Its 32 banks serve a word of 4 bytes each in a cycle. Accesses of 8 bytes go by half warps, those of 16 by quarters; a
word that several threads read counts once.
"""

from __future__ import annotations

import numpy as np

from warpvox.kernels.group import WARP, Group

BANKS = 32


def wavefronts(address: np.ndarray, width: int) -> int:
    """Cycles of accesses of ``width`` bytes (4, 8, 16) at ``address`` ``[accesses, threads of a warp]``, in bytes."""
    words = (address[..., None] // 4 + np.arange(width // 4)).reshape(-1, BANKS)
    return sum(int(np.bincount(np.unique(cycle) % BANKS).max()) for cycle in words)


def by_place(group: Group, memory: np.ndarray) -> dict[str, tuple[int, int]]:
    """Wavefronts of a warp by place in the source, all rounds of a loop together; and those without conflicts of banks.

    The places are those whose addresses follow from the tables of the body.

    Args:
        memory: uint8 ``[groups of a warp, bytes]`` after a control step on the CPU, where the tables hold numbers of
            elements instead of addresses.
    """
    begins = dict(
        zip(group.layout, np.cumsum([0, *(count * size for count, size in group.layout.values())]), strict=False)
    )
    bases = np.arange(len(memory))[:, None] * group.bytes

    def turns(rows: np.ndarray) -> np.ndarray:
        """``[groups, elements, n]`` to ``[rounds, n, groups, threads]``, as the threads take them."""
        return rows.reshape(len(memory), -1, group.parts, rows.shape[2]).transpose(1, 3, 0, 2)

    def own(field: str) -> np.ndarray:
        return turns(np.tile(np.arange(group.layout[field][0])[:, None], (len(memory), 1, 1)))

    def table(field: str, kind: type) -> np.ndarray:
        count, size = group.layout[field]
        whole = memory[:, begins[field] : begins[field] + count * size]
        return whole.view(kind).reshape(len(memory), count, -1).astype(np.int64)

    def cost(*accesses: tuple[str, np.ndarray, int, int]) -> tuple[int, int]:
        total = least = 0
        for field, rows, width, offset in accesses:
            address = (bases + begins[field] + group.layout[field][1] * rows + offset).reshape(-1, WARP)
            total += wavefronts(address, width)
            least += len(address) * width // 4
        return total, least

    ends, point, spring = table("spring", np.uint32)[:, :, :1], own("pos"), own("spring")
    first, second, pulls = turns(ends & 0xFFFF), turns(ends >> 16), turns(table("links", np.uint16))
    pull, disp = ("tension", 2 * spring, 16, 0), (("disp", first, 8, 0), ("disp", second, 8, 0))
    return {
        "relax": cost(
            ("spring", spring, 8, 0), ("length", spring, 4, 0), ("pos", first, 16, 0), ("pos", second, 16, 0), pull
        ),
        "stretch": cost(("spring", spring, 8, 0), *disp, pull),
        "limit": cost(("spring", spring, 4, 0), ("length", spring, 4, 4), *disp),
        "point": cost(("contact", point, 8, 0)),
        "floor": cost(("disp", point, 4, 4)),
        "gather": cost(("links", point, 16, 0), ("tension", pulls, 8, 0), ("disp", point, 8, 0)),
        "finish": cost(("disp", point, 8, 0)),
        # the velocity of a contact shares the place of the forces
        "advance": cost(*[("pos", point, 16, 0)] * 2, ("tension", 2 * point, 16, 0), ("contact", point, 8, 0)),
    }
