"""Functions that warpvox computes itself, beside those of the C library, which are off by a few last places at most."""

import numpy as np
import pytest
import warp as wp

from warpvox.kernels.kit import kit_of
from warpvox.kernels.sensing import arc_cosine

PLAIN = dict(enable_backward=False, module="unique", module_options={"fuse_fp": False})
LAST_PLACES = 3
SPECIAL = np.array(
    [0.0, -0.0, 5e-324, -1e-300, 22.0, -1e300, np.inf, -np.inf, np.nan, 0.5, -0.5, 1.0, -1.0, 1e-8, 0.17, 0.52]
)


def computed(kernel, numbers):
    found = wp.zeros(numbers.shape, dtype=wp.float64, device="cpu")
    wp.launch(kernel, len(numbers), [wp.array(numbers, dtype=wp.float64, device="cpu"), found], device="cpu")
    return found.numpy()


def tangents(numbers, width):
    array = wp.array3d(dtype=wp.float64)

    @kit_of("float64", width).func_native("native/tanh.h", code="values(found)[0] = tanh_of(values(given)[0]);")
    def tangent(given: array, found: array, pack, lane): ...

    @wp.kernel(**PLAIN)
    def kernel(given: array, found: array):
        tangent(given, found, wp.tid(), 0)

    return computed(kernel, numbers.reshape(-1, 1, width)).ravel()


@pytest.mark.parametrize("width", [1, 8])
def test_the_hyperbolic_tangent(width):
    drawn = np.random.default_rng(0)
    numbers = np.concatenate(
        [SPECIAL, drawn.uniform(-25, 25, 4000), drawn.normal(size=4000) * 10.0 ** drawn.uniform(-9, 0, 4000)]
    )
    found, expected = tangents(numbers, width), np.tanh(numbers)
    np.testing.assert_array_max_ulp(found, expected, LAST_PLACES)
    assert (np.signbit(found) == np.signbit(numbers))[~np.isnan(numbers)].all()


def test_the_arc_cosine():
    @wp.kernel(**PLAIN)
    def kernel(given: wp.array(dtype=wp.float64), found: wp.array(dtype=wp.float64)):
        found[wp.tid()] = arc_cosine(given[wp.tid()])

    drawn = np.random.default_rng(0)
    near = 1.0 - 10.0 ** drawn.uniform(-16, 0, 2000)
    numbers = np.concatenate([[0.0, 0.5, -0.5, 1.0, -1.0, 0.99999], near, -near, drawn.uniform(-1, 1, 4000)])
    np.testing.assert_array_max_ulp(computed(kernel, numbers), np.arccos(numbers), LAST_PLACES)
