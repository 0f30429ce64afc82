"""Lane operations against numpy."""

import numpy as np
import pytest
import warp as wp

from warpvox.kernels.lanes import REALS, casts, lane_ops

WIDTHS = (8, 16, 32)
SPECIAL = (0.0, -0.0, 1.5, -2.5, np.inf, -np.inf, np.nan, 1e-30)


def run(precision, width, a, b):
    """Every operation on two rows of lanes; results by name."""
    ops, real = lane_ops(precision, width), REALS[precision]
    value, load, store = ops.value, ops.load, ops.store
    mul, div, root, lower, upper, grow = ops.mul, ops.div, ops.root, ops.lower, ops.upper, ops.grow
    at_most, within, largest, splat = ops.at_most, ops.within, ops.largest, ops.splat
    widen, narrow = casts(precision, width).widen, casts(precision, width).narrow
    assert value is not None

    @wp.kernel(enable_backward=False, module="unique")
    def kernel(x: wp.array3d(dtype=real), out: wp.array3d(dtype=real), masks: wp.array(dtype=int)):
        p = load(x, 0, 0, 0)
        q = load(x, 0, 1, 0)
        store(out, 0, 0, 0, mul(p, q))
        store(out, 0, 1, 0, div(p, q))
        store(out, 0, 2, 0, root(p))
        store(out, 0, 3, 0, lower(p, q))
        store(out, 0, 4, 0, upper(p, q))
        store(out, 0, 5, 0, grow(splat(real(0.0)), q))
        store(out, 0, 6, 0, narrow(widen(p)))
        store(out, 0, 7, 0, splat(largest(grow(splat(real(0.0)), q))))
        masks[0] = at_most(p, q)
        masks[1] = within(p, q)

    x = wp.array(np.stack([a, b])[None], dtype=real, device="cpu")
    out, masks = wp.zeros((1, 8, width), dtype=real, device="cpu"), wp.zeros(2, dtype=int, device="cpu")
    wp.launch(kernel, 1, [x, out, masks], device="cpu")
    names = ("mul", "div", "root", "lower", "upper", "grow", "cast", "largest")
    found = dict(zip(names, out.numpy()[0], strict=True))
    bits = [np.array([(int(m) >> k) & 1 for k in range(width)], bool) for m in masks.numpy()]
    return found | {"at_most": bits[0], "within": bits[1]}


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("precision", sorted(REALS))
def test_operations_equal_those_of_numpy(precision, width):
    rng = np.random.default_rng(width)
    a = rng.choice([*SPECIAL, *rng.normal(size=20)], size=width).astype(precision)
    b = rng.choice([*SPECIAL, *rng.normal(size=20)], size=width).astype(precision)
    found = run(precision, width, a, b)
    with np.errstate(all="ignore"):
        expected = {
            "mul": a * b,
            "div": a / b,
            "root": np.sqrt(a),
            "lower": np.where(b < a, b, a),
            "upper": np.where(b > a, b, a),
            "grow": np.nan_to_num(np.abs(b), nan=0.0, posinf=np.inf),
            "cast": a,
            "largest": np.full(width, np.nanmax(np.abs(b), initial=0.0)),
            "at_most": a <= b,
            "within": np.abs(a) <= b,
        }
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


def test_the_lanes_of_a_mask_come_in_order():
    ops = lane_ops("float32", 1)
    first, drop = ops.first, ops.drop

    @wp.kernel(enable_backward=False, module="unique")
    def kernel(masks: wp.array(dtype=int), out: wp.array2d(dtype=int)):
        i = wp.tid()
        mask = masks[i]
        n = int(0)
        while mask != 0:
            out[i, n] = first(mask)
            mask = drop(mask)
            n += 1

    words = np.array([0, 1, -1, 0b1010, -(2**31)], dtype=np.int32)
    out = wp.full((len(words), 32), -1, dtype=int, device="cpu")
    wp.launch(kernel, len(words), [wp.array(words, dtype=int, device="cpu"), out], device="cpu")
    for word, row in zip(words, out.numpy(), strict=True):
        lanes = [k for k in range(32) if (int(word) >> k) & 1]
        assert row.tolist() == lanes + [-1] * (32 - len(lanes))
