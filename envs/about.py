"""Descriptions of terms: formula, unit, size and range, declared beside the term's code.

``warpvox tasks`` prints it, and the spaces of gymnasium take their bounds from it. Formulas are text only.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees, inf
from typing import Any, TypeVar

LENGTH, SPEED, ANGLE, NUMBER = "length", "speed", "rad", "number"
UNITS = {
    LENGTH: "10 voxels = 1",
    SPEED: "length per inner time; a control step lasts physics.substeps x physics.dt, 0.003 by default",
    ANGLE: "radians, counter-clockwise",
    NUMBER: "no unit",
}
"""Descriptions of the units of observations."""

Function = TypeVar("Function", bound=Callable[..., Any])


@dataclass(frozen=True)
class About:
    """Description of a term: formula, unit, range and number of columns.

    Attributes:
        formula: text with the term's parameters in braces; ``{low!d}`` writes an angle in degrees.
        unit: of an observation, one of :data:`UNITS`.
        entries: of an observation: how many, or a function of the term's parameters that says it.
        per_point: entries for every point of the object besides.
        low, high: between which all values of an observation lie.
    """

    formula: str
    unit: str = NUMBER
    entries: int | Callable[..., int] = 1
    per_point: int = 0
    low: float = -inf
    high: float = inf

    def text(self, params: Mapping[str, Any]) -> str:
        """Return the formula with the values of ``params`` inserted."""
        return _Filler().vformat(self.formula, (), params)

    def size(self, params: Mapping[str, Any], points: int) -> int:
        """Return the number of observation columns for an object with ``points`` points."""
        entries = self.entries(**params) if callable(self.entries) else self.entries
        return entries + self.per_point * points


def about(formula: str, **details: Any) -> Callable[[Function], Function]:
    """Attach an :class:`About` to a term's function (decorator)."""

    def decorate(function: Function) -> Function:
        function.about = About(formula, **details)  # pyright: ignore[reportFunctionMemberAccess] # functions take any
        return function

    return decorate


def about_of(function: Callable[..., Any]) -> About | None:
    """Return the :class:`About` attached to a function, or None."""
    return getattr(function, "about", None)


class _Filler(string.Formatter):
    """String formatter that writes numbers with six significant digits."""

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        return f"{degrees(value):g}°" if conversion == "d" else super().convert_field(value, conversion)

    def format_field(self, value: Any, format_spec: str) -> str:
        return f"{value:g}" if isinstance(value, float) else super().format_field(value, format_spec)
