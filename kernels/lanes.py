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


def _scalar_ops(real):
    @wp.func
    def splat(value: real):
        return value

    @wp.func
    def load(a: wp.array3d(dtype=real), pack: int, row: int, lane: int):
        return a[pack, row, lane]

    @wp.func
    def store(a: wp.array3d(dtype=real), pack: int, row: int, lane: int, value: real):
        a[pack, row, lane] = value

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
    def finite(a: real):
        return wp.where(wp.isfinite(a), 1, 0)

    names = "splat load store mul div root lower upper grow largest at_most finite".split()
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
    @wp.func_native(f"return *reinterpret_cast<{c_value}*>(&wp::index(a, pack, row, lane));")
    def load(a: wp.array3d(dtype=real), pack: int, row: int, lane: int) -> value: ...

    @wp.func_native(f"*reinterpret_cast<{c_value}*>(&wp::index(a, pack, row, lane)) = x;")
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

    @wp.func_native(mask_of("va - va == 0", "a"))
    def finite(a: value) -> int: ...  # inf - inf and NaN - NaN are NaN, which equals nothing

    names = "splat load store mul div root lower upper grow largest at_most finite".split()
    scope = locals()
    return {
        "value": value,
        "full": (1 << width) - 1 if width < 32 else -1,
        **{name: scope[name] for name in names},
    }
