"""Number of processes and threads for the lab's tests."""

from collections.abc import Iterator

import parallel
import pytest

parallel.one_thread_each()


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    """Return the number of processes for ``-n auto``."""
    return parallel.workers()


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, as the tests' tensors are tiny."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
