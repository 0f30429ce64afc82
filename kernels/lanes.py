"""Lane arithmetic: the same C++ source for one environment and for a SIMD vector of environments.

State arrays are ``[pack, row, lane]``. On the CPU one thread advances all lanes of a pack at once: a value is
a vector of ``width`` lanes, which the compiler turns into AVX code. On CUDA (and for a single environment)
``width`` is 1 and a value is a plain scalar. ``native/scalar.h`` and ``native/vector.h`` have the operations for one
case each; what works on all lanes is C++ written with them, and knows nothing else of the difference. What is rare
works in single lanes, and is a Warp function.

Two precisions meet in a simulation. State, contacts and everything that decides whether something happens are
float64, always: one contact that is missed or early changes an episode. Springs, the bulk of the work, compute in
the simulation's own precision, on displacements so small that float32 serves them well.
"""

import functools
from pathlib import Path

import warp as wp

REALS = {"float32": wp.float32, "float64": wp.float64}
MAX_WIDTH = 32  # a mask of lanes is one 32-bit integer

# Warp passes structs by value: a call that is not inlined copies all of Model and Data.
inline = functools.partial(wp.func, inline=True)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return __ffs(mask) - 1;
#else
    return __builtin_ctz((unsigned)mask);
#endif
"""
)
def first_lane(mask: int) -> int:
    """Return the lowest lane in a non-zero mask."""
    ...


@wp.func
def without_first(mask: int) -> int:
    """Clear the lowest lane in a mask."""
    return mask & (mask - 1)


def text(*files: str) -> str:
    """Read files of this folder and join them by line ends."""
    return "\n".join(Path(__file__).parent.joinpath(file).read_text(encoding="utf-8") for file in files)


def constants(**values: float) -> str:
    """Generate C++ definitions of named constants: an ``int`` as ``int``, a ``float`` as ``double``.

    Values must be finite and no bools, whose Python text is not C++.
    """
    return "\n".join(
        f"constexpr {'int' if isinstance(value, int) else 'double'} {name} = {value!r};"
        for name, value in values.items()
    )


@functools.cache
def native(files: tuple[str, ...], precision: str, width: int) -> str:
    """Assemble the C++ body of a Warp function from ``files``, for a precision and a lane width.

    ``Value`` holds the lanes in that precision, ``Wide`` in float64; ``values(array)[r]`` and ``wides(array)[r]`` are
    row r of the pack (``native/scalar.h``, ``native/vector.h``).
    """
    whole = text("native/scalar.h" if width == 1 else "native/vector.h", *files)
    return f"typedef {'float' if precision == 'float32' else 'double'} Real;\n" + whole.replace("WIDTH", str(width))
