"""The surrogate of Bayesian optimisation: a Gaussian process from one-hot voxels to fitness (paper Table 4)."""

# GPyTorch has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownLambdaType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

import warnings
from collections.abc import Generator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from botorch.exceptions import ModelFittingError
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.models.transforms import Standardize
from gpytorch.constraints import GreaterThan
from gpytorch.kernels import MaternKernel, ScaleKernel
from gpytorch.mlls import ExactMarginalLogLikelihood
from gpytorch.priors import LogNormalPrior

from warpvox.algos.search.bodies import CELL_TYPES
from warpvox.algos.search.settings import BO
from warpvox.errors import SearchError


@contextmanager
def own_torch(seed: int) -> Generator[None]:
    """Inside, torch draws from ``seed`` on one thread; afterwards it is as before.

    Sums of several threads depend on their number, and a search must not depend on the machine's load.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
            # a fit that stops at its limit of iterations is what is asked for, and nothing to be warned of
            warnings.simplefilter("ignore")
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(threads)


def one_hot(bodies: np.ndarray) -> torch.Tensor:
    """float64 ``[..., cells * 5]`` of int8 ``[..., rows, columns]``: a 1 for the type of each voxel."""
    flat = torch.as_tensor(np.asarray(bodies, dtype=np.int64)).flatten(-2)
    return torch.nn.functional.one_hot(flat, CELL_TYPES).flatten(-2).double()


def from_one_hot(points: torch.Tensor, shape: tuple[int, int]) -> np.ndarray:
    """int8 ``[n, rows, columns]`` of points ``[n, cells * 5]``: each voxel is of the type with the largest entry."""
    return points.detach().view(len(points), *shape, CELL_TYPES).argmax(-1).numpy().astype(np.int8)


def make_model(bodies: np.ndarray, fitness: Sequence[float], settings: BO) -> SingleTaskGP:
    """The process before its fit: Matern 5/2 with one variance and one length scale, fitness standardised.

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
    """The process with the largest marginal likelihood that L-BFGS finds from several starts."""
    model = make_model(bodies, fitness, settings)
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
        raise SearchError(f"The Gaussian process could not be fitted to {len(bodies)} designs: {error}.") from error
    return model
