"""Operations on lanes, in C++, against numpy."""

from fractions import Fraction

import numpy as np
import pytest
import warp as wp

from warpvox.kernels.kit import Kit
from warpvox.kernels.lanes import first_lane, without_first

SPECIAL = (0.0, -0.0, 1.5, -2.5, np.inf, -np.inf, np.nan, 1e-30)
CODE = """
const auto p = values(x), out = values(y);
const auto wide = wides(z);
out[0] = root(p[0]);
out[1] = quotient(p[0], p[1]);
out[2] = fused(p[0], p[1], p[2]);
out[3] = reduced(p[0], p[1], p[2]);
out[4] = narrow(widen(p[0]));
out[5] = weights(wp::index(masks, 0));
wide[0] = longer(widen(p[2] * p[2]), widen(p[1]));
wp::index(masks, 1) = bits_of(p[0] <= p[1]);
wp::index(masks, 2) = any_below(p[0]);
wp::index(ends, 0) = least(widen(p[0]));
wp::index(ends, 1) = largest(widen(p[0]));
"""


def run(precision, width, rows, mask):
    """Results on three rows of lanes, by name."""
    kit = Kit(precision, width)
    real = wp.array3d(dtype=kit.real)

    @kit.func_native(code=CODE)
    def operations(
        x: real, y: real, z: wp.array3d(dtype=wp.float64), ends: wp.array(dtype=wp.float64),
        masks: wp.array(dtype=int), pack, lane,
    ): ...  # fmt: skip

    @wp.kernel(enable_backward=False, module="unique", module_options={"fuse_fp": False})
    def kernel(
        x: real, y: real, z: wp.array3d(dtype=wp.float64), ends: wp.array(dtype=wp.float64), masks: wp.array(dtype=int)
    ):
        operations(x, y, z, ends, masks, 0, 0)

    x = wp.array(rows[None], dtype=kit.real, device="cpu")
    y, z = (
        wp.zeros((1, 6, width), dtype=kit.real, device="cpu"),
        wp.zeros((1, 1, width), dtype=wp.float64, device="cpu"),
    )
    ends = wp.zeros(2, dtype=wp.float64, device="cpu")
    masks = wp.array([mask, 0, 0], dtype=int, device="cpu")
    wp.launch(kernel, 1, [x, y, z, ends, masks], device="cpu")
    found = dict(zip(("root", "quotient", "fused", "reduced", "cast", "weights"), y.numpy()[0], strict=True))
    found |= dict(zip(("least", "largest"), ends.numpy(), strict=True)) | {"longer": z.numpy()[0, 0]}
    return found | {"bits_of": bits(masks.numpy()[1], width), "any_below": bool(masks.numpy()[2])}


def rounded_once(a, b, c):
    """a b + c of finite numbers without a rounding of the product."""
    found = a * b + c
    for k in np.flatnonzero(np.isfinite(found)):
        found[k] = float(Fraction(float(a[k])) * Fraction(float(b[k])) + Fraction(float(c[k])))
    return found


def bits(mask, width):
    return np.array([(int(mask) >> k) & 1 for k in range(width)], bool)


@pytest.mark.parametrize(
    ("precision", "width"), [("float32", 1), ("float64", 8), ("float32", 16), ("float32", 32), ("float64", 32)]
)
def test_operations_equal_those_of_numpy(precision, width):
    rng = np.random.default_rng(width)
    rows = rng.choice([*SPECIAL, *rng.normal(size=20)], size=(3, width)).astype(precision)
    mask = int(rng.integers(-(2**31), 2**31)) if width == 32 else int(rng.integers(2**width))
    found = run(precision, width, rows, mask)
    a, b, c = rows
    with np.errstate(all="ignore"):
        expected = {
            "root": np.sqrt(a),
            "quotient": a / b,
            "fused": rounded_once(a, b, c),
            "reduced": rounded_once(-a, b, c),
            "cast": a,
            "weights": bits(mask, width),
            "longer": np.where(np.abs(b) > c * c, np.abs(b), c * c),
            "bits_of": a <= b,
            "any_below": (a <= 0).any(),
            "least": np.nanmin(a, initial=np.inf) if width > 1 else a[0],
            "largest": np.nanmax(a, initial=-np.inf) if width > 1 else a[0],
        }
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


def test_the_lanes_of_a_mask_come_in_order():
    @wp.kernel(enable_backward=False, module="unique")
    def kernel(masks: wp.array(dtype=int), out: wp.array2d(dtype=int)):
        i = wp.tid()
        mask = masks[i]
        n = int(0)
        while mask != 0:
            out[i, n] = first_lane(mask)
            mask = without_first(mask)
            n += 1

    words = np.array([0, 1, -1, 0b1010, -(2**31)], dtype=np.int32)
    out = wp.full((len(words), 32), -1, dtype=int, device="cpu")
    wp.launch(kernel, len(words), [wp.array(words, dtype=int, device="cpu"), out], device="cpu")
    for word, row in zip(words, out.numpy(), strict=True):
        lanes = [k for k in range(32) if (int(word) >> k) & 1]
        assert row.tolist() == lanes + [-1] * (32 - len(lanes))
