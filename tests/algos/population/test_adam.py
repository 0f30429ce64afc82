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
        rate = torch.tensor(self.vector.param_groups[0]["lr"], dtype=torch.float64)
        self.vector.descend(self.vector.flat(gradients), LIMIT, rate, self.vector.steps + 1)
        self.vector.steps += 1

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


def test_each_row_of_stacked_networks_is_an_adam_of_its_own() -> None:
    """Three designs with different learning rates, gradients that are clipped and not, stepped in two shares."""
    random, rates = torch.Generator().manual_seed(0), torch.tensor([1e-3, 3e-4, 1e-2], dtype=torch.float64)
    scales = torch.tensor([0.01, 1.0, 100.0], dtype=torch.float64)[:, None, None]
    stacks = [nn.ParameterList(torch.randn(3, 4, columns, generator=random).double() for columns in (5, 1))]
    stacks.append(nn.ParameterList([torch.randn(3, 2, 2, generator=random).double()]))
    parts = [[[nn.Parameter(p[d].detach().clone()) for p in stack] for stack in stacks] for d in range(3)]
    ours = VectorAdam(stacks, RATE, EPS, stacked=True)
    theirs = [
        torch.optim.Adam([p for group in groups for p in group], lr=float(rate), eps=EPS)
        for groups, rate in zip(parts, rates, strict=True)
    ]
    for step in range(1, 21):
        gradients = [torch.randn(p.shape, generator=random).double() * scales for p in ours.parameters]
        for rows in (slice(2), slice(2, 3)):
            ours.descend(ours.flat([g[rows] for g in gradients]), LIMIT, rates[rows], step, rows)
        for d, optimizer in enumerate(theirs):
            for parameter, gradient in zip(optimizer.param_groups[0]["params"], gradients, strict=True):
                parameter.grad = gradient[d].clone()
            for group in parts[d]:
                nn.utils.clip_grad_norm_(group, LIMIT)
            optimizer.step()
    for k, parameter in enumerate(ours.parameters):
        stock = torch.stack([optimizer.param_groups[0]["params"][k].detach() for optimizer in theirs])
        torch.testing.assert_close(parameter.detach(), stock, rtol=0, atol=1e-12)
