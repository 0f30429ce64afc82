"""Random numbers of a training: states that are taken over, and states that are refused."""

import numpy as np
import pytest
import torch

from warpvox.algos.generators import Generators
from warpvox.errors import RunError


@pytest.mark.parametrize("drawn", [0, 1, 7, 623, 624, 625, 1300])
def test_any_state_of_a_generator_goes_on_as_it_would_have(drawn: int) -> None:
    generators = Generators(3)
    torch.rand(drawn, generator=generators.on("cpu"))
    state = generators.state()
    expected = torch.randn(700, generator=generators.on("cpu"))

    other = Generators(4)
    other.set_state(state)
    assert torch.equal(torch.randn(700, generator=other.on("cpu")), expected)


@pytest.mark.parametrize(("left", "place"), [(624, 624), (2, 624), (600, 26), (0, 1), (1, 625), (1, -1), (-5, 3)])
def test_counters_that_lead_beyond_the_numbers_are_refused(left: int, place: int) -> None:
    generators = Generators(3)
    damaged = generators.state()["cpu"].numpy().copy()
    damaged[8:12] = np.array([left], np.int32).view(np.uint8)
    damaged[16:24] = np.array([place], np.int64).view(np.uint8)

    with pytest.raises((RunError, RuntimeError)):
        generators.set_state({"cpu": torch.from_numpy(damaged)})
