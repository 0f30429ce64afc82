"""MAP-Elites: descriptors computed a second time, the grid, and who breeds."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusals import refused

from warpvox.algos.search import MapElites, make_search
from warpvox.algos.search.map_elites import describe
from warpvox.algos.search.settings import DESCRIPTORS
from warpvox.design import sample_design
from warpvox.errors import ConfigError

pytest.importorskip("ribs", reason="MAP-Elites needs the extra 'search'")


def by_hand(body: np.ndarray) -> dict[str, float]:
    rows, columns = body.shape
    cells = [(row, column, int(body[row, column])) for row in range(rows) for column in range(columns)]
    filled = [(row, column) for row, column, cell in cells if cell]
    high, wide = ([place[axis] for place in filled] for axis in (0, 1))

    def share(*kinds: int) -> float:
        return sum(cell in kinds for _, _, cell in cells) / len(cells)

    return {
        "actuators": share(3, 4),
        "empty": share(0),
        "rigid": share(1),
        "soft": share(2),
        "horizontal": share(3),
        "vertical": share(4),
        "height": (max(high) - min(high) + 1) / rows,
        "width": (max(wide) - min(wide) + 1) / columns,
        "symmetry": sum(cell == body[row, columns - 1 - column] for row, column, cell in cells) / len(cells),
    }


@given(st.integers(0, 10**6), st.tuples(st.integers(2, 5), st.integers(2, 6)))
def test_descriptors_by_hand(seed: int, shape: tuple[int, int]) -> None:
    body = sample_design(shape, seed)
    expected = by_hand(body)
    assert set(expected) == set(DESCRIPTORS)
    numbers = describe(body[None], DESCRIPTORS)
    assert numbers.shape == (1, len(DESCRIPTORS))
    assert numbers[0] == pytest.approx([expected[name] for name in DESCRIPTORS])
    assert (numbers >= 0).all()
    assert (numbers <= 1).all()


def test_the_grid_holds_the_best_of_every_kind_and_they_breed() -> None:
    settings = MapElites(descriptors=("height", "symmetry"), bins=4, max_designs=150)
    search = make_search(settings, (5, 7), seed=0)
    best: dict[tuple[int, ...], int] = {}
    bodies, fitness = [], []
    while asked := search.ask():
        if bodies:
            parents = [candidate.parents for candidate in asked]
            assert all(len(of) == 1 and of[0] in best.values() for of in parents)
            assert len(set(parents)) > 1
        told = [float(np.sin(7 * candidate.body.sum())) for candidate in asked]
        for candidate, value in zip(asked, told, strict=True):
            bodies.append(candidate.body)
            fitness.append(value)
            numbers = by_hand(candidate.body)
            cell = tuple(min(3, int(numbers[name] * 4 + 1e-6)) for name in settings.descriptors)
            if cell not in best or value > fitness[best[cell]]:
                best[cell] = candidate.id
        search.tell(told)
        assert search.elites() == sorted(best.values())


def test_mistakes_in_descriptors() -> None:
    with refused(ConfigError, "descriptors must be one of", "got 'actuator'. Did you mean 'actuators'"):
        MapElites(descriptors=("actuator",))
    for wrong in ((), ("empty", "empty")):
        with pytest.raises(ConfigError):
            MapElites(descriptors=wrong)
    for bins, names in ((10**12, DESCRIPTORS[:1]), (10, DESCRIPTORS)):
        with refused(ConfigError, f"bins={bins} for {len(names)} descriptors"):
            MapElites(bins=bins, descriptors=list(names))
    with refused(ConfigError, "descriptors must be a list, got 'empty'"):
        MapElites(descriptors="empty")  # type: ignore[arg-type]
