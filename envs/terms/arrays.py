"""Array operations that torch and numpy name differently, so that every term works with both.

A batch of environments has tensors ``[num_envs, ...]``; a single one on the CPU has arrays ``[1, ...]``, because
starting an operation of torch takes longer than what it has to compute. What both have (operators, slices, ``abs``)
terms use as it is.
"""

import sys
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

Array: TypeAlias = "np.ndarray | Tensor"


def library(array: Array) -> Any:
    """Return the array module (numpy or torch) of an array."""
    return np if isinstance(array, np.ndarray) else sys.modules["torch"]


def double(array: Array) -> Any:
    """Convert an array to float64."""
    return array.astype(np.float64) if isinstance(array, np.ndarray) else array.double()


def long(array: Array) -> Any:
    """Convert an array to int64, rounding towards 0."""
    return array.astype(np.int64) if isinstance(array, np.ndarray) else array.long()


def filled(like: Array, shape: tuple[int, ...], value: float) -> Any:
    """Create an array filled with one value, with the type and device of ``like``."""
    return np.full(shape, value, like.dtype) if isinstance(like, np.ndarray) else like.new_full(shape, value)


def replaced(array: Array, where: Any, value: float) -> Any:
    """Replace entries where the mask ``where`` is True by ``value``; array and mask are broadcast."""
    if isinstance(array, np.ndarray):
        return np.where(where, array.dtype.type(value), array)
    return array.masked_fill(where, value)  # a number for `where` would have to be brought to the device


def taken(array: Array, index: Any) -> Any:
    """Gather entries of every row of ``array`` ``[rows, n]`` at ``index``, integers ``[rows, k]``."""
    if isinstance(array, np.ndarray):
        return array[np.arange(len(array))[:, None], index]
    return array.gather(1, index)


def extremes_at(array: Array, index: Any, values: Any, which: str) -> None:
    """Reduce values into ``array[row, index]`` by minimum (``amin``) or maximum (``amax``).

    Args:
        array: ``[rows, n]``, written to.
        index: integers ``[rows, k]``, the places of ``values`` ``[rows, k]``.
    """
    if isinstance(array, np.ndarray):
        rows = np.arange(len(array))[:, None]
        {"amin": np.minimum, "amax": np.maximum}[which].at(array, (rows, index), values)
    else:
        array.scatter_reduce_(1, index, values, which)
