"""Tools for writing stages: types for one precision and lane width, and decorators.

A stage is made by a *builder*, a function of a :class:`Kit` that returns a Warp function. In Warp functions an argument
without a type gets it by its name: ``model``, ``data``, ``tape`` are the structs, ``dt`` and ``margin`` float64, all
others int.
"""

import functools
import inspect
from pathlib import Path

import warp as wp

from warpvox.kernels.lanes import REALS, constants, inline, native
from warpvox.kernels.state import CPP_CONSTANTS, structs


class Kit:
    """Types, structs and decorators for Warp functions of one precision and lane width.

    Attributes:
        precision, width, real: 'float32' or 'float64', lanes, and Warp's type.
        Model, Data, Tape, Contact: the structs.
    """

    def __init__(self, precision: str, width: int):
        self.precision = precision
        self.width = width
        self.real = REALS[precision]
        types = structs(precision)
        self.Model = types.Model
        self.Data = types.Data
        self.Tape = types.Tape
        self.Contact = types.Contact
        self._types = dict(model=self.Model, data=self.Data, tape=self.Tape, dt=wp.float64, margin=wp.float64)

    def func(self, source):
        """Decorate a Warp function so that it is inlined; a call would copy its structs.

        Parameters without annotation get the type of their name (``model``, ``dt``, ...), else int.
        """
        return inline(self._typed(source))

    def func_native(self, *files: str, precision: str | None = None, code: str = "", **values: float):
        """Return a decorator for a Warp function whose body is C++ from this folder.

        Warp looks for this name to find out what the function returns.

        Args:
            values: constants of that body, by name.
        """
        parts = constants(**CPP_CONSTANTS, **values), native(files, precision or self.precision, self.width), code
        body = "\n".join(parts)
        return lambda source: wp.func_native(body)(self._typed(source))

    def stage(self, *files: str, precision: str | None = None, **values: float):
        """Create a stage whose body is C++ (see :meth:`func_native`)."""

        def stage(model, data, mesh, pack, lane, unit, dt): ...

        stage.__qualname__ = "_".join([Path(files[-1]).stem, *map(str, values.values())])  # Warp's name for it
        return self.func_native(*files, precision=precision, code="", **values)(stage)

    def _typed(self, source):
        given = source.__annotations__
        source.__annotations__ = {n: self._types.get(n, int) for n in inspect.signature(source).parameters} | given
        return source


@functools.cache
def kit_of(precision: str, width: int) -> Kit:
    """Return the kit of a precision ('float32', 'float64') and a lane width (1 to 32), cached."""
    return Kit(precision, width)


def builder(build):
    """Decorate a function of a Kit so that its result is cached for each kit.

    It may also be called with a precision and a width.
    """
    cached = functools.cache(build)

    @functools.wraps(build)
    def made(kit: Kit | str, width: int = 1):
        return cached(kit if isinstance(kit, Kit) else kit_of(kit, width))

    return made
