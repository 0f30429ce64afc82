"""Number of processes and of threads of the lab's tests."""

from collections.abc import Iterator

import parallel
import pytest

parallel.one_thread_each()


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    """How many processes ``-n auto`` starts."""
    return parallel.workers()


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Tensors of tests are tiny: a pool of threads only costs time on a busy machine."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
