"""Fitness by the user's own code, named by file or module."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from warpvox.algos.codesign.settings import Codesign, Fitness, register_fitness
from warpvox.code import check_code, load_code
from warpvox.errors import ConfigError
from warpvox.keys import key

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator


@register_fitness
@dataclass
class Custom(Fitness):
    """Fitness by the user's own code; see docs/own_search.md."""

    name: str = key("custom", "a fitness of your own", choices=("custom",))
    make: str | None = key(
        None,
        "FILE.py:NAME or MODULE:NAME, called with the settings of the search and those below; makes an evaluator",
    )
    settings: Any = key(None, "settings of your own, by name: {episodes:3}")

    def check(self, search: Codesign) -> None:
        """Raise an error unless ``make`` names code that makes an evaluator from these settings."""
        check_code(self.make, "fitness=custom needs fitness.make", "an evaluator of the search's settings")
        self.build(search, None)

    def inherits(self, search: Codesign) -> bool:
        return search.training.inherit

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        """Call the user's code and return the evaluator.

        Raises:
            ConfigError: no such file, module or name, settings that it does not take, or it makes no evaluator.
        """
        function = load_code(cast(str, self.make))
        settings = self.settings or {}
        try:
            inspect.signature(function).bind(search, **settings)
        except TypeError as error:
            raise ConfigError(f"'{self.make}' does not take these settings: {error}.") from error
        made = function(search, **settings)
        if not callable(getattr(made, "evaluate", None)):
            raise ConfigError(
                f"'{self.make}' makes a {type(made).__name__}, which has no method"
                " evaluate(candidates, parents, report)."
            )
        return made
