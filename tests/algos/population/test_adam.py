"""Adam on a matrix against torch's Adam and its clipping of gradients."""

import torch
from torch import nn

from warpvox.algos.population.ppo import VectorAdam

EPS, LIMIT = 1e-5, 0.5


def test_each_row_of_stacked_networks_is_an_adam_of_its_own() -> None:
    """Three designs with different learning rates, gradients that are clipped and not, stepped in two shares."""
    random, rates = torch.Generator().manual_seed(0), torch.tensor([1e-3, 3e-4, 1e-2], dtype=torch.float64)
    scales = torch.tensor([0.01, 1.0, 100.0], dtype=torch.float64)[:, None, None]
    stacks = [nn.ParameterList(torch.randn(3, 4, columns, generator=random).double() for columns in (5, 1))]
    stacks.append(nn.ParameterList([torch.randn(3, 2, 2, generator=random).double()]))
    parts = [[[nn.Parameter(p[d].detach().clone()) for p in stack] for stack in stacks] for d in range(3)]
    ours = VectorAdam(stacks, EPS)
    theirs = [
        torch.optim.Adam([p for group in groups for p in group], lr=float(rate), eps=EPS)
        for groups, rate in zip(parts, rates, strict=True)
    ]
    for step in range(1, 21):
        if step == 10:  # goes on from its state
            state = {name: value if name == "steps" else value.clone() for name, value in ours.state().items()}
            ours = VectorAdam(stacks, EPS)
            ours.set_state(state)
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
