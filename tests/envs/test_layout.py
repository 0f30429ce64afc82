"""Observations of designs of different sizes in one tensor."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from warpvox.envs.layout import Layout
from warpvox.envs.spec import observes
from warpvox.envs.state import State
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
    layout = Layout(terms, sim, State(sim))
    rows = layout.observe(State(sim))
    assert tuple(rows.shape) == (len(points), layout.num_obs)
    for design, count in enumerate(points):
        alone = []
        for name, term in zip(names, terms, strict=True):
            value = term(State(sim))[design]
            alone.append(value[:, : count if name == "shape" else 4].flatten() if value.ndim == 2 else value)
            assert torch.equal(rows[design, layout.columns[design][term.name]], alone[-1])
        expected = torch.cat(alone)
        assert torch.equal(rows[design, : len(expected)], expected)
        assert not rows[design, len(expected) :].any()
        assert layout.mask[design].tolist() == [k < len(expected) for k in range(layout.num_obs)]


def test_every_observation_is_a_fresh_tensor(puppet) -> None:
    sim = puppet([4, 6])
    layout = Layout((TERMS["shape"],), sim, State(sim))
    state = State(sim)
    first = layout.observe(state)
    first.fill_(7.0)
    assert not (layout.observe(state) == 7.0).any()


def test_the_dtype_is_that_of_the_simulation(puppet) -> None:
    sim = puppet([4, 6], dtype=torch.float32)
    assert Layout(tuple(TERMS.values())[:2], sim, State(sim)).observe(State(sim)).dtype == torch.float32
