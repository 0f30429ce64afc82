"""Model and acquisition of Bayesian optimisation: expected improvement and posterior samples."""

# GPyTorch and parts of BoTorch and torch have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownLambdaType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

import math
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from botorch.acquisition import LogExpectedImprovement
from botorch.exceptions import ModelFittingError
from botorch.fit import fit_gpytorch_mll
from botorch.generation import MaxPosteriorSampling
from botorch.models import SingleTaskGP
from botorch.models.transforms import Standardize
from botorch.optim import optimize_acqf
from botorch.sampling.pathwise import draw_matheron_paths
from gpytorch.constraints import GreaterThan
from gpytorch.kernels import MaternKernel, ScaleKernel
from gpytorch.mlls import ExactMarginalLogLikelihood
from gpytorch.priors import LogNormalPrior

from warpvox.algos.search.bodies import CELL_TYPES, neighbours
from warpvox.algos.search.settings import BO
from warpvox.design import are_valid
from warpvox.devices.startup import own_torch
from warpvox.errors import SearchError

_NOTHING = 1e-9
"""Smallest gain of a climb; smaller ones are rounding errors."""


@dataclass
class Climb:
    """Result of climbing n functions to their local maxima.

    Attributes:
        start: int ``[n]``, place in the pool where each began.
        at_pool: ``[n, m]``, values of the pool.
        summit: int8 ``[n, rows, columns]``.
        around: int8 ``[n, k, rows, columns]``, the neighbours of the summit.
        at_around: ``[n, k]``, their values; -inf where they are not valid.
    """

    start: np.ndarray
    at_pool: np.ndarray
    summit: np.ndarray
    around: np.ndarray
    at_around: np.ndarray


def thompson_starts(model: SingleTaskGP, pool: np.ndarray, count: int) -> np.ndarray:
    """Select the best body of the pool under each of ``count`` posterior samples; return indices ``[count]``."""
    points = one_hot(pool)
    with torch.no_grad():
        chosen = MaxPosteriorSampling(model, replacement=False)(points, num_samples=count)
    # Different bodies have different one-hot points: the largest product is with the body itself.
    return (chosen @ points.T).argmax(-1).numpy()


def improve(model: SingleTaskGP, best: float, starts: np.ndarray, iterations: int) -> np.ndarray:
    """Maximise expected improvement by L-BFGS from each start; return bodies ``[n, rows, columns]``, valid or not.

    Voxels become continuous on the way: the point moves in the box [0, 1] of the one-hot entries and is rounded in
    the end. The logarithm of expected improvement has the same maxima, and gradients where there is hardly any.
    """
    points = one_hot(starts)
    box = torch.stack([torch.zeros_like(points[0]), torch.ones_like(points[0])])
    ends, _ = optimize_acqf(
        LogExpectedImprovement(model, best_f=best),
        box,
        q=1,
        num_restarts=len(points),
        batch_initial_conditions=points[:, None],
        return_best_only=False,
        options={"maxiter": iterations},
    )
    entries = ends[:, 0].detach().view(*starts.shape, CELL_TYPES)
    return entries.argmax(-1).numpy().astype(np.int8)


def log_improvement(model: SingleTaskGP, best: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that computes the log of expected improvement over ``best`` for bodies, ``[n]``.

    BoTorch's own is made for few points and gradients; this one has the posterior of all points computed at once.
    With u standard deviations between the mean and ``best``, expected improvement is
    ``deviation * (phi(u) + u Phi(u))``; below 0 both terms nearly cancel, and erfcx keeps what is left.
    """

    def values(bodies: np.ndarray) -> np.ndarray:
        """Compute the logarithm of expected improvement of each body."""
        with torch.no_grad():
            posterior = model.posterior(one_hot(bodies))
            deviation = posterior.variance[:, 0].sqrt()
            u = (posterior.mean[:, 0] - best) / deviation
        density = -u.square() / 2 - math.log(2 * math.pi) / 2
        tail = torch.special.erfcx(u.clamp(max=0).abs() / math.sqrt(2)) * math.sqrt(math.pi / 2)
        below = density + torch.log1p(u.clamp(max=0) * tail)
        above = (density.exp() + u.clamp(min=0) * torch.special.ndtr(u)).log()
        return (deviation.log() + torch.where(u < 0, below, above)).numpy()

    return values


def ascend(
    values: Callable[[np.ndarray], np.ndarray], entries: np.ndarray, free: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray | None:
    """Climb from the best free entry, one voxel at a time, over free bodies only; None if none is free.

    Args:
        values: of a single function: bodies ``[k, rows, columns]`` to ``[k]``.
        entries: bodies ``[k, rows, columns]``. Should none of them be free, the climb begins at the best of the free
            bodies beside the last one.
        free: bodies ``[k, rows, columns]`` to bool ``[k]``: what the climb may pass and end at.
    """
    summit = None
    height = -math.inf
    around = entries
    while True:
        usable = around[free(around)]
        heights = values(usable) if len(usable) else np.array([-math.inf])
        best = int(heights.argmax())
        if heights[best] > height + _NOTHING:
            summit = usable[best]
            height = float(heights[best])
        elif summit is not None or around is not entries:
            return summit
        around = neighbours((entries[-1] if summit is None else summit)[None])[0]


def climb_posterior(model: SingleTaskGP, pool: np.ndarray, count: int) -> Climb:
    """Draw ``count`` functions from the posterior and maximise each over valid bodies."""
    paths = draw_matheron_paths(model, torch.Size([count]))

    def values(bodies: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return paths(one_hot(bodies)).numpy()

    return climb(values, pool)


def climb(values: Callable[[np.ndarray], np.ndarray], pool: np.ndarray) -> Climb:
    """Maximise n functions from the best body of the pool, one voxel at a time, over valid bodies only.

    Args:
        values: of n functions at once: bodies ``[k, rows, columns]``, the same for all, or ``[n, k, rows,
            columns]`` to values ``[n, k]``.
        pool: valid bodies ``[m, rows, columns]``.
    """
    at_pool = values(pool)
    start = at_pool.argmax(1)
    current = pool[start]
    height = at_pool.max(1)
    each = np.arange(len(start))
    while True:
        around = neighbours(current)
        usable = are_valid(around.reshape(-1, *pool.shape[1:])).reshape(around.shape[:2])
        at_neighbours = np.where(usable, values(around), -np.inf)
        best = at_neighbours.argmax(1)
        higher = at_neighbours[each, best] > height + _NOTHING
        if not higher.any():
            return Climb(start, at_pool, current, around, at_neighbours)
        current = np.where(higher[:, None, None], around[each, best], current)
        height = np.where(higher, at_neighbours[each, best], height)


@contextmanager
def seeded_torch(seed: int) -> Generator[None]:
    """Seed torch and use one thread within the block; afterwards restore its state.

    Sums of several threads depend on their number, and a search must not depend on the machine's load.
    """
    with own_torch(1), warnings.catch_warnings():
        # no warnings about fits that stop at their limit of iterations, which is intended
        warnings.simplefilter("ignore")
        torch.manual_seed(seed)
        yield


def one_hot(bodies: np.ndarray) -> torch.Tensor:
    """Encode bodies int8 ``[..., rows, columns]`` one-hot as float64 ``[..., cells * 5]``."""
    flat = torch.as_tensor(np.asarray(bodies, dtype=np.int64)).flatten(-2)
    return torch.nn.functional.one_hot(flat, CELL_TYPES).flatten(-2).double()


def _make_model(bodies: np.ndarray, fitness: Sequence[float], settings: BO) -> SingleTaskGP:
    """Create the Gaussian process: Matern 5/2 with one length scale, standardised fitness.

    The priors are there for the restarts, which draw from them; without any, all would start alike.
    """
    base = MaternKernel(
        nu=2.5,
        lengthscale_prior=LogNormalPrior(1.0, 1.0),
        lengthscale_constraint=GreaterThan(2.5e-2, initial_value=settings.kernel_length_scale),
    )
    bounded = GreaterThan(1e-4, initial_value=settings.kernel_variance)
    kernel = ScaleKernel(base, outputscale_prior=LogNormalPrior(0.0, 1.0), outputscale_constraint=bounded)
    targets = torch.tensor(list(fitness), dtype=torch.float64)[:, None]
    return SingleTaskGP(one_hot(bodies), targets, covar_module=kernel.double(), outcome_transform=Standardize(1))


def fit_model(bodies: np.ndarray, fitness: Sequence[float], settings: BO) -> SingleTaskGP:
    """Fit the Gaussian process by L-BFGS from several starts; return the fit of largest marginal likelihood."""
    model = _make_model(bodies, fitness, settings)
    try:
        fit_gpytorch_mll(
            ExactMarginalLogLikelihood(model.likelihood, model),
            max_attempts=settings.optimizer_restarts,
            pick_best_of_all_attempts=True,
            # the limit of iterations counts as a success
            warning_handler=lambda warning: True,
            optimizer_kwargs={"options": {"maxiter": settings.optimizer_iterations}},
        )
    except ModelFittingError as error:
        raise SearchError(f"The Gaussian process could not be fitted to {len(bodies)} designs. {error}") from error
    return model
