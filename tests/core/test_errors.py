import pytest

import warpvox
from warpvox import errors


def test_every_error_is_a_warpvox_error_and_of_the_builtin_kind_that_callers_expect() -> None:
    bad_input = "DesignError WorldError TaskError ActionError ConfigError RunError RolloutError".split()
    for name in bad_input:
        assert issubclass(getattr(errors, name), errors.WarpvoxError)
        assert issubclass(getattr(errors, name), ValueError)
    for name in ("DeviceError", "SearchError", "SimulationError"):
        assert issubclass(getattr(errors, name), errors.WarpvoxError)
        assert issubclass(getattr(errors, name), RuntimeError)


def test_every_error_has_a_public_name() -> None:
    ours = [
        name
        for name, value in vars(errors).items()
        if getattr(value, "__module__", "") == errors.__name__ and isinstance(value, type)
    ]
    assert {"StorageError", "DivergenceError"} <= set(ours) <= set(warpvox.__all__)
    assert all(getattr(warpvox, name) is getattr(errors, name) for name in ours)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("Walker-v1", " Did you mean 'Walker-v0'?"),
        ("walker-V0", " Did you mean 'Walker-v0'?"),
        ("climber", " Did you mean 'Climber-v0'?"),
        ("zzz", ""),
        (17, ""),
    ],
)
def test_did_you_mean(given: object, sentence: str) -> None:
    assert errors.did_you_mean(given, ["Walker-v0", "Climber-v0", "Carrier-v0"]) == sentence
