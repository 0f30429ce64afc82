"""Random number generators of one training, separate from the process-wide ones."""

from __future__ import annotations

from typing import Any

import torch
from torch.overrides import TorchFunctionMode

from warpvox.algos.expected import AnyTensor, check_like
from warpvox.errors import RunError

_DRAWING = frozenset({
    "rand", "randn", "randint", "randperm", "normal", "bernoulli", "multinomial", "poisson",
    "bernoulli_", "cauchy_", "exponential_", "geometric_", "log_normal_", "normal_", "random_", "uniform_",
    "kaiming_normal_", "kaiming_uniform_", "trunc_normal_", "xavier_normal_", "xavier_uniform_",
})  # fmt: skip
"""torch functions, tensor methods and weight initialisers that take a ``generator``."""


class Generators(TorchFunctionMode):
    """Random generators of a training, one per kind of device, equal to torch's own after the same seed.

    As a context manager, it makes all random numbers that this thread draws by torch come from these generators; other
    threads are not affected. It slows down each call of torch: use it to make networks, not in every step.

    Args:
        seed: of the generators; None: they go on from where torch's own are.
        device: that is drawn for besides the CPU.
    """

    def __init__(self, seed: int | None = None, device: str = "cpu") -> None:
        super().__init__()
        self._generators = {"cpu": torch.Generator()}
        if (kind := torch.device(device).type) != "cpu":
            self._generators[kind] = torch.Generator(device)
        for kind, generator in self._generators.items():
            if seed is not None:
                generator.manual_seed(seed)
            else:
                generator.set_state(torch.get_rng_state() if kind == "cpu" else torch.cuda.get_rng_state(device))

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Intercept torch functions within the block, and pass a generator to those that draw random numbers."""
        kwargs = kwargs or {}
        if getattr(func, "__name__", "") in _DRAWING and kwargs.get("generator") is None:
            first = args[0] if args else None
            # torch 2.7 cannot be asked for its default device once that was set to None.
            device = kwargs.get("device") or torch.empty(0).device
            device = torch.device(first.device if isinstance(first, torch.Tensor) else device)
            if device.type != "meta":  # meta tensors have no values
                kwargs = {**kwargs, "generator": self.on(device)}
        return func(*args, **kwargs)

    def on(self, device: str | torch.device) -> torch.Generator:
        """Return the generator for a device."""
        return self._generators[torch.device(device).type]

    @property
    def seed(self) -> int:
        """Initial seed of the generators."""
        return self.on("cpu").initial_seed()

    def state(self) -> dict[str, torch.Tensor]:
        """Return the state of each generator by kind of device, for :meth:`set_state`."""
        return {kind: generator.get_state() for kind, generator in self._generators.items()}

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        """Restore a :meth:`state`; missing kinds of devices are left unchanged. RunError: not valid."""
        like = {kind: AnyTensor(torch.uint8, (None,)) for kind in {"cpu", *state}}
        check_like(state, like, "random")

        # Byte 8 starts the count of numbers left, int32; byte 16 the index of the next one, uint64. torch checks each
        # alone, but together they can point beyond the end of the numbers.
        if len(state["cpu"]) >= 24:
            left = int(state["cpu"][8:12].cpu().view(torch.int32))
            place = int(state["cpu"][16:24].cpu().view(torch.int64))
            twister_size = 624  # numbers that the Mersenne Twister MT19937 makes at once
            if left + place > twister_size + 1:
                raise RunError(f"random.cpu has {left} numbers left at place {place} of {twister_size}.")

        for kind in self._generators.keys() & state.keys():
            self._generators[kind].set_state(state[kind].cpu())
