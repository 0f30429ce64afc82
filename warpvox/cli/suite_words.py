"""Keys of ``warpvox codesign`` that hold for all searches of a suite: ``KEY=VALUE`` words, each key once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from warpvox.algos.codesign.settings import CHANGEABLE
from warpvox.algos.training.pretrained import find_pretrained, kept_name
from warpvox.cli.overrides import key_and_value, key_and_word
from warpvox.code import Code, is_code
from warpvox.configs.composition import quoted
from warpvox.errors import ConfigError
from warpvox.trust import COPIES, STORED, allowed

PRETRAINED = "evaluation.pretrained"


def by_key(words: Sequence[str]) -> dict[str, str]:
    """The words by their keys, as Hydra takes them; of two for one key the last."""
    return dict(map(key_and_word, words))


def merged(words: Sequence[str], typed: Sequence[str], output_dir: str) -> list[str]:
    """``words`` with those that were typed; a pretrained policy by its place, as the latest may be another later."""
    found = by_key([*words, *typed])
    if PRETRAINED in found:
        _, name = key_and_value(found[PRETRAINED])
        found[PRETRAINED] = f"{PRETRAINED}={quoted(kept_name(name, find_pretrained(name, output_dir)[0]))}"
    return list(found.values())


def gone_on_with(words: Sequence[str], typed: Sequence[str], home: Path) -> tuple[list[str], list[str]]:
    """The words of a suite in ``home`` that goes on: as it has them, and with the code that was named again."""
    before, now = by_key(words), by_key(typed)
    trusted = {}
    for key, word in now.items():
        if key in CHANGEABLE:
            before[key] = word
        elif key not in COPIES and before.get(key) != word:
            has = f"it has {before[key]}" if key in before else "it is not among those of the suite"
            raise ConfigError(f"{key} cannot change when a suite is resumed ({has}, asked for {word}).")
    for key, word in before.items():
        value = key_and_value(word)[1]
        if key in COPIES and is_code(value):
            mine = key_and_value(now[key])[1] if key in now else None
            value = allowed(key, value, Code(mine) if is_code(mine) else mine, home)
            word = f"{key}={quoted(str(value))}"
        trusted[key] = word
    for key in now:
        if key in COPIES and key_and_value(now[key])[1] == STORED and key not in before:
            raise ConfigError(f"{key}={STORED} names code in the folder of a run; {home} has none for {key}.")
    return list(before.values()), list(trusted.values())
