"""The curves of a design search: what they say of finalists, whatever evaluates the designs."""

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from warpvox.algos.archive import FILE, Archive, Finished
from warpvox.algos.candidate import FINALIST, Candidate, Outcome, best_so_far
from warpvox.algos.codesign.results import Found
from warpvox.algos.codesign.settings import FITNESS, Codesign
from warpvox.algos.report import report_page
from warpvox.algos.report.members import read_members

RETURNS = st.lists(st.floats(-10, 10, width=32), min_size=1, max_size=6)
WITH_FINALISTS = [name for name, one in FITNESS.items() if getattr(one(), "finalists", 0)]


def search_in(folder: Path, evaluation: str, screened: list[float], final: list[float]) -> Archive:
    """The archive of a search in generations of two, whose best designs are evaluated again."""
    archive = Archive.create(folder / FILE, {"task": "Walker-v0", "evaluation": {"name": evaluation}})
    bodies = [np.array([[3, 3 + k % 2, k // 2 + 1]]) for k in range(len(screened))]
    generations = [list(range(k, min(k + 2, len(screened)))) for k in range(0, len(screened), 2)]
    for number, ids in enumerate(generations):
        archive.propose([Candidate(k, bodies[k], (), "random", number) for k in ids], 0)
        archive.finish([Finished(k, Outcome(screened[k], [(10, screened[k])], 10, None)) for k in ids])
    order = sorted(range(len(screened)), key=lambda k: -screened[k])
    last = [
        Candidate(len(screened) + place, bodies[parent], (parent,), FINALIST, len(generations))
        for place, parent in enumerate(order[: len(final)])
    ]
    archive.propose(last, 0)
    archive.finish(
        [Finished(one.id, Outcome(value, [(5, value)], 20)) for one, value in zip(last, final, strict=False)]
    )
    return archive


@pytest.mark.parametrize("evaluation", FITNESS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(screened=RETURNS, final=RETURNS, data=st.data())
def test_the_best_so_far_never_falls_and_ends_at_the_best_design(
    evaluation: str, screened: list[float], final: list[float], data: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    final = final[: len(screened)] if evaluation in WITH_FINALISTS and data.draw(st.booleans()) else []
    folder = tmp_path_factory.mktemp("search")
    with search_in(folder, evaluation, screened, final) as archive:
        best = archive.best()[0]
        page = report_page(archive, {}, folder)
    (member,) = read_members([folder])
    assert (np.diff(member.best) >= 0).all()
    assert member.best[-1] == best.fitness
    assert member.winner.id == best.id
    assert member.evaluations[-1] == len(screened) + len(final)
    assert member.steps[-1] == 10 * len(screened) + 20 * len(final)
    assert member.best[-1] == best.fitness
    found = Found(folder, Codesign(), {})
    assert found.curve["best"].tolist() == member.best.tolist()
    # the line of the report: up is less
    chart = page[page.index("<h2>Fitness") : page.index("<h2>Best designs")]
    lines = re.findall(r'<path class="curve s1" d="([^"]+)"', chart)
    assert len(lines) == (len(member.best) > 1)
    for line in lines:
        heights = [float(y) for y in re.findall(r"(?:M[\d.]+ |V)([\d.-]+)", line)]
        assert all(after <= before for before, after in itertools.pairwise(heights))
        assert len(heights) == len(member.best)


def test_a_finalist_and_its_parent_are_both_among_the_designs(tmp_path: Path) -> None:
    for evaluation in WITH_FINALISTS:
        (tmp_path / evaluation).mkdir()
        with search_in(tmp_path / evaluation, evaluation, [1.0, 3.0, 2.0], [4.0, 2.5]) as archive:
            assert len({one.candidate.body.tobytes() for one in archive.best(9)}) == len(archive.best(9)) == 3
        designs = {record.id: record for record in Found(tmp_path / evaluation, Codesign(), {}).designs}
        assert sorted(designs) == [0, 1, 2, 3, 4]
        for record in designs.values():
            assert all(np.array_equal(designs[parent].design, record.design) for parent in record.candidate.parents)
            assert record.candidate.origin != FINALIST or record.candidate.parents


def test_where_both_have_policies_of_their_own_the_better_design_is_the_best(tmp_path: Path) -> None:
    with search_in(tmp_path, "gaits", [1.0, 3.0], [2.0, 0.5]) as archive:
        assert [one.id for one in archive.best(9)] == [1, 0]
    (tmp_path / "equal").mkdir()
    with search_in(tmp_path / "equal", "gaits", [1.0, 3.0], [3.0]) as archive:
        assert archive.best()[0].candidate.origin == FINALIST


@given(st.lists(st.tuples(st.integers(0, 1000), st.floats(-10, 10))))
def test_the_best_so_far_of_a_curve(curve: list[tuple[int, float]]) -> None:
    found = best_so_far(curve)
    assert [steps for steps, _ in found] == [steps for steps, _ in curve]
    assert [value for _, value in found] == list(itertools.accumulate((value for _, value in curve), max))
