"""Targets of bodies: the last ones stay, and a body has its newest."""

import torch

from warpvox.algos.training.ascent import Targets


def bodies(*numbers: int) -> torch.Tensor:
    return torch.tensor([[[float(number)]] for number in numbers])


def content(targets: Targets) -> list[tuple[float, float]]:
    """Pairs of body and target, oldest first."""
    state = targets.state()
    return list(zip(state["bodies"].flatten().tolist(), state["targets"].flatten().tolist(), strict=True))


def test_the_last_stay_and_a_body_has_its_newest() -> None:
    targets = Targets(4)
    targets.add(bodies(1, 2, 3), bodies(10, 20, 30))
    targets.add(bodies(2, 4, 2), bodies(21, 40, 22))
    assert content(targets) == [(1, 10), (3, 30), (2, 22), (4, 40)]
    targets.add(bodies(5), bodies(50))
    assert content(targets) == [(3, 30), (2, 22), (4, 40), (5, 50)]
    assert len(targets) == 4


def test_bodies_are_drawn_with_their_targets_and_from_a_state_the_same() -> None:
    targets, other = Targets(8), Targets(8)
    targets.add(bodies(*range(6)), 10 * bodies(*range(6)))
    other.set_state(targets.state())
    torch.manual_seed(0)
    drawn = targets.draw(64)
    torch.manual_seed(0)
    assert all(torch.equal(one, two) for one, two in zip(drawn, other.draw(64), strict=True))
    assert torch.equal(drawn[1], 10 * drawn[0])
    assert len(drawn[0].unique()) == 6
    other.add(bodies(3), bodies(0))
    assert content(other)[-1] == (3, 0)
    assert len(other) == 6
