"""Adam on a vector against torch's Adam and its clipping of gradients."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import nn

from warpvox.algos.training.adam import VectorAdam

EPS, RATE, LIMIT = 1e-5, 3e-3, 0.5


def networks() -> list[nn.Module]:
    torch.manual_seed(0)
    return [nn.Sequential(nn.Linear(4, 5), nn.Tanh(), nn.Linear(5, count)).double() for count in (3, 1)]


def parameters(pair: list[nn.Module]) -> list[nn.Parameter]:
    return [parameter for network in pair for parameter in network.parameters()]


class Pair:
    """The same networks twice, with our optimiser and with torch's."""

    def __init__(self) -> None:
        self.ours, self.theirs = networks(), networks()
        self.vector = VectorAdam(self.ours, RATE, EPS)
        self.stock = torch.optim.Adam(parameters(self.theirs), lr=RATE, eps=EPS)
        self.random = torch.Generator().manual_seed(1)

    def step(self) -> None:
        scale = float(10 ** torch.randint(-2, 2, (), generator=self.random))  # some are clipped
        gradients = [
            scale * torch.randn(p.shape, generator=self.random, dtype=p.dtype) for p in parameters(self.theirs)
        ]
        for parameter, gradient in zip(parameters(self.theirs), gradients, strict=True):
            parameter.grad = gradient.clone()
        for network in self.theirs:
            nn.utils.clip_grad_norm_(network.parameters(), LIMIT)
        self.stock.step()
        self.vector.descend(torch.cat([gradient.flatten() for gradient in gradients]), LIMIT)

    def check(self) -> None:
        for ours, theirs in zip(parameters(self.ours), parameters(self.theirs), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-12)


def test_steps_are_torchs_with_gradients_clipped_network_by_network() -> None:
    pair = Pair()
    for _ in range(20):
        pair.step()
    pair.check()
    for group in (*pair.vector.param_groups, *pair.stock.param_groups):
        group["lr"] = 0.1 * RATE
    pair.step()
    pair.check()


def test_states_are_exchanged_with_torchs_adam() -> None:
    pair = Pair()
    for _ in range(3):
        pair.step()
    # copies, as files are: torch's own states go on being those of the optimiser
    ours, theirs = copy.deepcopy((pair.vector.state_dict(), pair.stock.state_dict()))
    assert ours["state"].keys() == theirs["state"].keys()
    for number, moments in theirs["state"].items():
        for name, value in moments.items():
            torch.testing.assert_close(ours["state"][number][name], value, rtol=0, atol=1e-12)
    again = Pair()
    for fresh, trained in zip(parameters(again.ours + again.theirs), parameters(pair.theirs + pair.ours), strict=True):
        fresh.data.copy_(trained.data)
    again.vector.load_state_dict(theirs)
    again.stock.load_state_dict(ours)
    again.random.set_state(pair.random.get_state())
    for one in (again, pair):
        one.step()
        one.check()
    again.theirs = pair.theirs
    again.check()


def test_a_state_from_before_the_first_step_begins_anew() -> None:
    pair = Pair()
    empty = pair.stock.state_dict()
    pair.step()
    fresh = Pair()
    pair.vector.load_state_dict(empty)
    for ours, theirs in zip(parameters(pair.ours), parameters(fresh.ours), strict=True):
        ours.data.copy_(theirs.data)
    pair.theirs, pair.stock = fresh.theirs, fresh.stock
    pair.step()
    pair.check()


def test_step_says_what_to_call() -> None:
    with pytest.raises(NotImplementedError, match="descend"):
        Pair().vector.step()
