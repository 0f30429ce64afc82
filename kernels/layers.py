"""Kernels of fully connected layers with tanh between them, forward and backward, in float32 for AVX-512.

A tile of rows goes through all layers at once, so that results stay in the cache. ``native/layers_table.h`` says what a
table holds: sizes, addresses and strides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpvox.kernels.device import kernel, launch
from warpvox.kernels.lanes import text

__all__ = ["LANES", "TILE", "run_backward", "run_forward"]

LANES = 16
"""Columns of weights and results are a multiple of it."""
TILE = 96
"""Rows that go through all layers together: a multiple of the 6 that a product takes at once."""


@wp.func_native(text("native/products.h", "native/layers_table.h", "native/layers_forward.h"))
def _forward(table: wp.uint64, design: int): ...


@wp.func_native(text("native/products.h", "native/layers_table.h", "native/layers_backward.h"))
def _backward(table: wp.uint64, design: int): ...


@kernel
def _layers_forward(table: wp.uint64):
    _forward(table, wp.tid())


@kernel
def _layers_backward(table: wp.uint64):
    _backward(table, wp.tid())


def run_forward(networks: int, table: Sequence[int]) -> None:
    """Outputs of all layers of some networks; what the table points to must be alive until this returns."""
    _run(_layers_forward, networks, table)


def run_backward(networks: int, table: Sequence[int]) -> None:
    """Gradients of all weights and biases, likewise."""
    _run(_layers_backward, networks, table)


def _run(layers: wp.Kernel, networks: int, table: Sequence[int]) -> None:
    numbers = np.array(table, np.int64)
    launch(layers, networks, [numbers.ctypes.data], "cpu")
