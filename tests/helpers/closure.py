"""Dependencies of dependencies, from the metadata of installed distributions."""

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def required(found: Distribution, extras: set[str]) -> Iterator[Requirement]:
    """List the requirements of a distribution on this Python and platform, with the given extras."""
    for text in found.requires or ():
        asked = Requirement(text)
        if asked.marker is None or any(asked.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield asked


def extras_of(name: str) -> set[str]:
    return set(distribution(name).metadata.get_all("Provides-Extra") or ())


def installed_closure(name: str, extras: set[str]) -> dict[str, Distribution]:
    """Collect all installed direct and indirect requirements of ``name``, by canonical name.

    What an extra asks for need not be installed and is left out; whether anything else is missing says `pip check`.
    """
    found: dict[str, Distribution] = {}
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting = [(name, frozenset(extras))]
    while waiting:
        entry = waiting.pop()
        if entry in seen:
            continue
        seen.add(entry)
        try:
            one = distribution(entry[0])
        except PackageNotFoundError:
            continue
        found[canonical(entry[0])] = one
        waiting += [(canonical(asked.name), frozenset(asked.extras)) for asked in required(one, set(entry[1]))]
    del found[canonical(name)]
    return found
