"""Check of error messages: one sentence with the given value and the allowed ones."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def refused(error: Any, *named: object) -> Iterator[pytest.ExceptionInfo]:
    """Assert that the block raises one of these errors, in one line that contains all of ``named``."""
    with pytest.raises(error) as caught:
        yield caught
    sentence = str(caught.value)
    assert "\n" not in sentence.strip()
    for value in named:
        assert str(value) in sentence, f"{value!r} is not in: {sentence}"
