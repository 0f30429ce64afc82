"""Validation of a file's content before use: names, types, shapes, finite numbers."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from warpvox.errors import RunError


@dataclass(frozen=True)
class AnyTensor:
    """Placeholder for any tensor of this type and shape; None in ``shape`` allows any length."""

    dtype: torch.dtype
    shape: tuple[int | None, ...]
    is_finite: bool = True


def check_like(found: Any, like: Any, name: str = "") -> None:
    """Raise RunError unless ``found``, read from a file, has the same types and shapes as ``like``.

    Args:
        like: a tensor, for one of its type and shape with finite numbers; an :class:`AnyTensor`; a type, for a value
            of this type, which is not below 0 if it is an integer; None; dictionaries and lists of these.
        name: of the entry, for the error; at the top of a file there may be entries that ``like`` lacks.
    """
    if isinstance(like, Mapping):
        if not isinstance(found, Mapping):
            raise _misfit(name, f"a dictionary of {len(like)} entries", found)
        for key, value in like.items():
            place = f"{name}.{key}" if name else str(key)
            if key not in found:
                raise RunError(f"It lacks {place!r:.100}.")
            check_like(found[key], value, place)
        unknown = [key for key in found if key not in like]
        if name and unknown:
            raise RunError(f"Its {name!r:.100} has an entry too many, {unknown[0]!r:.40}.")
    elif isinstance(like, list | tuple):
        if type(found) is not type(like) or len(found) != len(like):
            raise _misfit(name, f"a {type(like).__name__} of {len(like)}", found)
        for place, (one, value) in enumerate(zip(found, like, strict=True)):
            check_like(one, value, f"{name}[{place}]")
    elif isinstance(like, torch.Tensor | AnyTensor):
        lengths = tuple(like.shape)
        kind = str(like.dtype).removeprefix("torch.")
        wanted = f"{kind} [{', '.join('n' if length is None else str(length) for length in lengths)}]"
        if not isinstance(found, torch.Tensor) or found.dtype != like.dtype or found.ndim != len(lengths):
            raise _misfit(name, wanted, found)
        if any(length not in (None, size) for length, size in zip(lengths, found.shape, strict=True)):
            raise _misfit(name, wanted, found)
        may_be_infinite = isinstance(like, AnyTensor) and not like.is_finite
        if not may_be_infinite and not bool(torch.isfinite(found).all()):
            raise RunError(f"Its {name!r:.100} has numbers that are not finite.")
    elif like is None:
        if found is not None:
            raise _misfit(name, "None", found)
    elif type(found) is not like or (like is int and found < 0):
        raise _misfit(name, {int: "an integer from 0", float: "a number", dict: "a dictionary"}.get(like, like), found)


def _misfit(name: str, wanted: object, found: object) -> RunError:
    """Build the error for an entry with an unexpected type or shape."""
    got = f"{found!r:.60}"
    if isinstance(found, torch.Tensor):
        got = f"{str(found.dtype).removeprefix('torch.')} {list(found.shape)}"
    return RunError(f"Its {name!r:.100} must be {wanted}, got {got}.")


def optimizer_state(found: Any, optimizer: torch.optim.Optimizer, name: str) -> dict[str, Any]:
    """Validate an optimiser's state from a file, and return it for ``optimizer.load_state_dict``.

    torch neither compares moments with the parameters nor looks at their strides, and goes on in them beyond their
    ends: what is returned are copies with all numbers in order.

    Raises:
        RunError: ``found`` is not the state of such an optimiser.
    """
    groups = optimizer.state_dict()["param_groups"]
    check_like(found, {"state": dict, "param_groups": list}, name)
    if len(found["param_groups"]) != len(groups):
        raise _misfit(f"{name}.param_groups", f"a list of {len(groups)}", found["param_groups"])

    # Learning rates
    for group, given in zip(groups, found["param_groups"], strict=True):
        rate = given.get("lr") if isinstance(given, Mapping) else None
        if not isinstance(rate, float) or not 0 <= rate < float("inf"):
            raise _misfit(f"{name}.lr", "a number from 0", rate)
        group["lr"] = rate

    # Example: the optimiser's state after a step of a parameter with two numbers
    tried = nn.Parameter(torch.zeros(2))
    tried.grad = torch.zeros(2)
    known = inspect.signature(type(optimizer)).parameters.keys() - {"params"}
    settings = {name: value for name, value in optimizer.param_groups[0].items() if name in known}
    trial = type(optimizer)([tried], **settings)
    trial.step()
    moments = dict(trial.state[tried])

    # Moments, of all parameters that had a gradient
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for number, entry in found["state"].items():
        place = f"{name}.state.{number!s:.20}"
        if type(number) is not int or not 0 <= number < len(parameters):
            raise RunError(f"Its {place!r} belongs to none of the {len(parameters)} parameters.")
        check_like(
            entry,
            {key: _expected_moment(entry, key, value, parameters[number]) for key, value in moments.items()},
            place,
        )

    # Copies
    state: dict[int, dict[str, Any]] = {}
    for number, entry in found["state"].items():
        state[number] = {}
        for key, value in entry.items():
            is_tensor = isinstance(value, torch.Tensor)
            state[number][key] = value.clone(memory_format=torch.contiguous_format) if is_tensor else value
    return {"state": state, "param_groups": groups}


def _expected_moment(entry: Any, key: str, moment: Any, parameter: torch.Tensor) -> Any:
    """Return the expected type and shape of an optimiser's entry ``key`` for one parameter."""
    if not isinstance(moment, torch.Tensor):
        return None if moment is None else type(moment)
    if moment.shape == (2,):
        return AnyTensor(parameter.dtype, tuple(parameter.shape))
    # torch counts steps in its default precision, which may have been different when the file was written.
    given = entry.get(key) if isinstance(entry, Mapping) else None
    dtype = moment.dtype
    if isinstance(given, torch.Tensor) and given.dtype in (torch.float32, torch.float64):
        dtype = given.dtype
    return AnyTensor(dtype, tuple(moment.shape))


def check_plain(content: Any) -> None:
    """Raise ValueError unless all tensors in nested dictionaries and lists are plain and fully stored."""
    waiting: list[Any] = [content]
    seen: set[int] = set()  # a file may have lists that contain themselves
    while waiting:
        one = waiting.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, torch.Tensor):
            plain = type(one) in (torch.Tensor, nn.Parameter) and one.layout == torch.strided
            if not plain or one.is_meta or one.is_quantized or one.is_conj() or one.is_neg():
                raise ValueError("a tensor is not a plain one")
            if (
                one.numel() * one.element_size() > one.untyped_storage().nbytes()
            ):  # a view can repeat one number a million times
                raise ValueError("a tensor is a view that repeats its numbers")
        elif isinstance(one, Mapping):
            waiting.extend(one.values())
        elif isinstance(one, Sequence) and not isinstance(one, str | bytes):
            waiting.extend(one)
