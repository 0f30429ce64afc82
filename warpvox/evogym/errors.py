"""Errors of the drop-in; they are also the builtin errors that scripts written for EvoGym catch."""

from warpvox.errors import WarpvoxError

__all__ = ["ArgumentError", "ArgumentTypeError", "InstallError", "RangeError"]


class ArgumentError(WarpvoxError, ValueError):
    """An argument that is not valid: an unknown name, a time without a record, a wrong number of values."""


class ArgumentTypeError(WarpvoxError, TypeError):
    """An argument of the wrong type."""


class RangeError(ArgumentError, AssertionError):
    """An argument out of range, where EvoGym has an assertion."""


class InstallError(WarpvoxError, ImportError):
    """``import evogym`` cannot be made to import this package."""
