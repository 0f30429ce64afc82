"""Observations of designs of different sizes in one tensor."""

from __future__ import annotations

import torch
from hypothesis import given, strategies as st

from warpvox.envs.observations import ObservationLayout
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import observes
from warpvox.envs.terms.observations import orientation, shape, velocity

TERMS = {
    "velocity": observes(velocity),
    "shape": observes(shape),
    "package": observes(shape, "package"),
    "orientation": observes(orientation),
}


@given(
    points=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    names=st.lists(st.sampled_from(sorted(TERMS)), min_size=1, max_size=4, unique=True),
)
def test_real_entries_come_first_and_equal_those_of_the_design_alone(puppet, points, names) -> None:
    terms = tuple(TERMS[name] for name in names)
    sim = puppet(points, objects=("package",))
    layout = ObservationLayout(terms, sim, Snapshot(sim))
    rows = layout.observe(Snapshot(sim))
    assert tuple(rows.shape) == (len(points), layout.num_obs)
    for design, count in enumerate(points):
        alone = []
        for name, term in zip(names, terms, strict=True):
            value = term(Snapshot(sim))[design]
            alone.append(value[:, : count if name == "shape" else 4].flatten() if value.ndim == 2 else value)
            assert torch.equal(rows[design, layout.columns[design][term.name]], alone[-1])
        expected = torch.cat(alone)
        assert torch.equal(rows[design, : len(expected)], expected)
        assert not rows[design, len(expected) :].any()
        assert layout.mask[design].tolist() == [k < len(expected) for k in range(layout.num_obs)]


def test_every_observation_is_a_fresh_tensor(puppet) -> None:
    sim = puppet([4, 6])
    layout = ObservationLayout((TERMS["shape"],), sim, Snapshot(sim))
    state = Snapshot(sim)
    first = layout.observe(state)
    first.fill_(7.0)
    assert not (layout.observe(state) == 7.0).any()


def test_the_dtype_is_that_of_the_simulation(puppet) -> None:
    sim = puppet([4, 6], dtype=torch.float32)
    assert (
        ObservationLayout(tuple(TERMS.values())[:2], sim, Snapshot(sim)).observe(Snapshot(sim)).dtype == torch.float32
    )
