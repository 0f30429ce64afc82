"""One thread of torch for the tests of environments."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def always_one_thread(one_thread: None) -> None: ...
