"""Arithmetic on lanes: one kernel source for a scalar and for a vector of environments.

State arrays are ``[pack, row, lane]``. On the CPU one thread advances all lanes of a pack at once: a value is
a ``wp.vec`` of ``width`` lanes, which the compiler turns into AVX code. On CUDA (and for a single environment)
``width`` is 1 and a value is a plain scalar. :func:`lane_ops` returns the operations for one case; every
physics kernel is written with them and knows nothing else of the difference.

Two precisions meet in a simulation. State, contacts and everything that decides whether something happens are
float64, always: one contact that is missed or early changes an episode. Springs, the bulk of the work, compute in
the simulation's own precision, on displacements so small that float32 serves them well.
"""

import functools
from pathlib import Path
from types import SimpleNamespace

import warp as wp

REALS = {"float32": wp.float32, "float64": wp.float64}
MAX_WIDTH = 32  # a mask of lanes is one 32-bit integer

# Warp passes structs by value: a call that is not inlined copies all of Model and Data.
inline = functools.partial(wp.func, inline=True)

_C_NAMES = {wp.float32: "float", wp.float64: "double"}


@functools.cache
def lane_ops(precision: str, width: int) -> SimpleNamespace:
    """The lane operations for a precision ('float32', 'float64') and a width (1 to 32).

    A *mask* is an int whose bit ``i`` speaks of lane ``i``; loops over a mask's lanes use ``first`` and ``drop``.
    """
    real = REALS[precision]
    ops = _scalar_ops(real) if width == 1 else _vector_ops(real, width)
    return SimpleNamespace(real=real, width=width, first=_first, drop=_drop, **ops)


@functools.cache
def casts(precision: str, width: int) -> SimpleNamespace:
    """``widen`` a value of a precision to float64, ``narrow`` it back."""
    real = REALS[precision]
    if width == 1:

        @wp.func
        def widen(a: real):
            return wp.float64(a)

        @wp.func
        def narrow(a: wp.float64):
            return real(a)

        return SimpleNamespace(widen=widen, narrow=narrow)
    small, large = (lane_ops(name, width).value for name in (precision, "float64"))
    copy = "wp::vec_t<{0}, {1}> r; for (int i = 0; i < {0}; ++i) r[i] = ({1})a[i]; return r;"

    @wp.func_native(copy.format(width, "double"))
    def widen(a: small) -> large: ...

    @wp.func_native(copy.format(width, _C_NAMES[real]))
    def narrow(a: large) -> small: ...

    return SimpleNamespace(widen=widen, narrow=narrow)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return __ffs(mask) - 1;
#else
    return __builtin_ctz((unsigned)mask);
#endif
"""
)
def _first(mask: int) -> int:
    """The lowest lane in a mask that is not empty."""
    ...


@wp.func
def _drop(mask: int) -> int:
    """The mask without its lowest lane."""
    return mask & (mask - 1)


def text(*files: str) -> str:
    """The C++ in files of this folder, one after another."""
    return "\n".join(Path(__file__).parent.joinpath(file).read_text(encoding="utf-8") for file in files)


@functools.cache
def native(files: tuple[str, ...], precision: str, width: int) -> str:
    """The body of a native function of a pack and a lane, in C++ of ``files``, for a precision and a width.

    ``Value`` holds the lanes in that precision, ``Wide`` in float64; ``values(array)[r]`` and ``wides(array)[r]`` are
    row r of the pack (``native/scalar.h``, ``native/vector.h``).
    """
    whole = text("native/scalar.h" if width == 1 else "native/vector.h", *files)
    return f"typedef {_C_NAMES[REALS[precision]]} Real;\n" + whole.replace("WIDTH", str(width))


def _place(c_real: str, width: int) -> str:
    """C++ for ``at``, the address of a lane.

    Warp's own indexing minds negative indices and reads strides; in these loops that costs as much as the physics.
    On the CPU a pack is as wide as a value, which makes the distance of two rows a constant.
    """
    return f"""
#if defined(__CUDA_ARCH__)
    const size_t between = a.strides[1];
#else
    const size_t between = {width} * sizeof({c_real});
#endif
    {c_real}* at = reinterpret_cast<{c_real}*>(
        reinterpret_cast<char*>(a.data) + size_t(pack) * a.strides[0] + size_t(unsigned(row)) * between
    ) + lane;"""


def _scalar_ops(real):
    @wp.func
    def splat(value: real):
        return value

    place = _place(_C_NAMES[real], 1)

    @wp.func_native(f"{place} return *at;")
    def load(a: wp.array3d(dtype=real), pack: int, row: int, lane: int) -> real: ...

    @wp.func_native(f"{place} *at = x;")
    def store(a: wp.array3d(dtype=real), pack: int, row: int, lane: int, x: real): ...

    @wp.func
    def mul(a: real, b: real):
        return a * b

    @wp.func
    def div(a: real, b: real):
        return a / b

    @wp.func
    def root(a: real):
        return wp.sqrt(a)

    @wp.func
    def lower(a: real, b: real):
        return wp.min(a, b)

    @wp.func
    def upper(a: real, b: real):
        return wp.max(a, b)

    @wp.func
    def grow(a: real, b: real):
        if wp.abs(b) > a:
            return wp.abs(b)
        return a

    @wp.func
    def largest(a: real):
        return a

    @wp.func
    def at_most(a: real, b: real):
        return wp.where(a <= b, 1, 0)

    @wp.func
    def within(a: real, bound: real):
        return wp.where(wp.abs(a) <= bound, 1, 0)

    names = "splat load store mul div root lower upper grow largest at_most within".split()
    scope = locals()
    return {"value": real, "full": 1, **{name: scope[name] for name in names}}


def _vector_ops(real, width):
    value = wp.types.vector(length=width, dtype=real)
    c_real = _C_NAMES[real]
    c_value = f"wp::vec_t<{width}, {c_real}>"
    root_of = "__builtin_sqrtf" if real is wp.float32 else "__builtin_sqrt"

    def each(expression):
        return f"{c_value} r; for (int i = 0; i < {width}; ++i) r[i] = {expression}; return r;"

    def mask_of(relation, *operands):
        """Clang's extended vectors compare straight into a mask register."""
        loads = "".join(f"values v{x} = 0; __builtin_memcpy(&v{x}, &{x}, sizeof({x})); " for x in operands)
        return f"""
            typedef {c_real} values __attribute__((ext_vector_type({max(width, 8)})));
            typedef bool bits __attribute__((ext_vector_type({max(width, 8)})));
            {loads}
            bits m = __builtin_convertvector({relation}, bits);
            unsigned r = 0;
            __builtin_memcpy(&r, &m, {max(width, 8) // 8});
            return (int)(r & {(1 << width) - 1}u);
        """

    @wp.func
    def splat(x: real):
        return value(x)

    # A pack's lanes are contiguous, so a row of lanes is one vector in memory.
    place = _place(c_real, width)

    @wp.func_native(f"{place} return *reinterpret_cast<{c_value}*>(at);")
    def load(a: wp.array3d(dtype=real), pack: int, row: int, lane: int) -> value: ...

    @wp.func_native(f"{place} *reinterpret_cast<{c_value}*>(at) = x;")
    def store(a: wp.array3d(dtype=real), pack: int, row: int, lane: int, x: value): ...

    @wp.func_native(each("a[i] * b[i]"))
    def mul(a: value, b: value) -> value: ...

    @wp.func_native(each("a[i] / b[i]"))
    def div(a: value, b: value) -> value: ...

    @wp.func_native(each(f"{root_of}(a[i])"))
    def root(a: value) -> value: ...

    @wp.func_native(each("b[i] < a[i] ? b[i] : a[i]"))
    def lower(a: value, b: value) -> value: ...

    @wp.func_native(each("b[i] > a[i] ? b[i] : a[i]"))
    def upper(a: value, b: value) -> value: ...

    # max(a, |b|) that ignores NaN in b: one broken lane must not blind the others.
    @wp.func_native(each("b[i] > a[i] ? b[i] : (-b[i] > a[i] ? -b[i] : a[i])"))
    def grow(a: value, b: value) -> value: ...

    @wp.func_native(f"{c_real} r = a[0]; for (int i = 1; i < {width}; ++i) r = a[i] > r ? a[i] : r; return r;")
    def largest(a: value) -> real: ...

    @wp.func_native(mask_of("va <= vb", "a", "b"))
    def at_most(a: value, b: value) -> int: ...

    # |a| <= bound, which NaN never is.
    @wp.func_native(mask_of("(va <= vb) & (va >= -vb)", "a", "b"))
    def within(a: value, b: value) -> int: ...

    names = "splat load store mul div root lower upper grow largest at_most within".split()
    scope = locals()
    return {
        "value": value,
        "full": (1 << width) - 1 if width < 32 else -1,
        **{name: scope[name] for name in names},
    }
