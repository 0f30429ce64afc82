"""Errors of the drop-in: of our tree, and of the builtin kinds that scripts written for EvoGym catch."""

from warpvox.errors import WarpvoxError

__all__ = ["ArgumentError", "ArgumentTypeError", "InstallError", "RangeError"]


class ArgumentError(WarpvoxError, ValueError):
    """An argument that is not valid: an unknown name, a time without a record, a wrong number of values."""


class ArgumentTypeError(WarpvoxError, TypeError):
    """An argument of another type than the one asked for."""


class RangeError(ArgumentError, AssertionError):
    """An argument out of range, where the release asserts that it is within."""


class InstallError(WarpvoxError, ImportError):
    """``import evogym`` cannot be made to import this package."""
