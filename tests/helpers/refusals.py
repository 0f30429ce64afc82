"""Errors as people meet them: one sentence, which has what was given and what it takes."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def refused(error: Any, *named: object) -> Iterator[pytest.ExceptionInfo]:
    """Assert that the block raises this error, or one of these, in a line that names all of ``named``."""
    with pytest.raises(error) as caught:
        yield caught
    sentence = str(caught.value)
    assert "\n" not in sentence.strip()
    for value in named:
        assert str(value) in sentence, f"{value!r} is not in: {sentence}"
