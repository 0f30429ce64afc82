"""Networks of policies by name (key ``policy``)."""

import inspect
from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from warpvox.algos.generators import Generators
from warpvox.algos.policies.grid import GridNetwork
from warpvox.algos.policies.layout import CLOCK, FEATURES, VoxelLayout, layout_of
from warpvox.algos.policies.transformer import TransformerNetwork
from warpvox.algos.settings import MAX_LAYERS, MLP
from warpvox.checks import is_integer
from warpvox.code import is_code, load_code
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError, did_you_mean, first_line, listing

NETWORKS: dict[str, type[nn.Module]] = {"grid": GridNetwork, "transformer": TransformerNetwork}
POLICIES = (MLP, *NETWORKS)


def check_policy(name: object) -> None:
    """Raise ConfigError unless ``name`` is a known policy or names code; the code is not imported."""
    if name not in POLICIES and not is_code(name):
        raise ConfigError(
            f"policy must be one of {listing(POLICIES)}, or a network of your own, module:Class or file.py:Class; got"
            f" {name!r:.80}.{did_you_mean(str(name), POLICIES)}"
        )


def layout_for(name: str, env: VoxelVecEnv) -> VoxelLayout:
    """Return the layout of environments for a network, with the clock's ``periods`` from the network's class."""
    check_policy(name)
    return layout_of(env, getattr(NETWORKS.get(name) or load_code(name), "periods", CLOCK))


def voxels_of(name: str, env: VoxelVecEnv, settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Build the arguments ``network``, ``settings`` and ``layout`` of :class:`VoxelModel` for a policy."""
    return {"network": name, "settings": dict(settings or {}), "layout": layout_for(name, env).dict()}


def check_network(env: VoxelVecEnv, name: str, settings: Any, key: str = "network") -> VoxelLayout:
    """Validate a network and its ``settings`` by creating one; return its layout."""
    if settings is not None and not isinstance(settings, Mapping):
        raise ConfigError(f"{key} must be settings by name, such as {{width:32}}; got {settings!r:.80}.")
    layout = layout_for(name, env)
    actor = make_network(name, layout, False, settings)
    shapes = ([2, layout.cells, FEATURES], [2, layout.rest])
    with Generators(0), torch.no_grad():  # the critic and what networks draw do not matter
        for network, wanted in (actor, [2, layout.cells]), (make_network(name, layout, True, settings), [2]):
            try:
                found = list(network.eval()(*map(torch.zeros, shapes)).shape)
            except Exception as error:  # code of the user's may raise anything
                found = first_line(error)
            if found != wanted:
                takes = f"cells {shapes[0]} and rest {shapes[1]} of two bodies"
                raise ConfigError(f"policy={name} must make {wanted} of {takes}, got: {found}.")
    return layout


def make_network(name: str, layout: VoxelLayout, critic: bool, settings: Mapping[str, Any] | None = None) -> nn.Module:
    """Create the network of an actor or a critic.

    Args:
        name: of :data:`POLICIES`, or ``module:Class`` or ``file.py:Class``: a ``torch.nn.Module`` made by
            ``Class(layout, critic, **settings)``, whose ``forward(cells, rest)`` is as that of :class:`GridNetwork`.
        critic: whether there is one value for the body instead of one for each cell.
    """
    check_policy(name)
    if is_integer(layers := (settings or {}).get("layers", 1)) and layers > MAX_LAYERS:
        raise ConfigError(f"policy={name} may have {MAX_LAYERS} layers at most, got {layers}.")
    made = NETWORKS.get(name) or load_code(name)
    try:
        inspect.signature(made).bind(layout, critic, **(settings or {}))
    except TypeError as error:
        known = [one for one in inspect.signature(made).parameters if one not in ("layout", "critic")]
        wrong = [one for one in settings or {} if one not in known]
        hint = did_you_mean(wrong[0], known) if wrong else ""
        raise ConfigError(f"policy={name} has the settings {listing(known)} ({error}).{hint}") from None
    network = made(layout, critic, **(settings or {}))
    if not isinstance(network, nn.Module):
        raise ConfigError(f"policy={name} must make a torch.nn.Module, got {type(network).__name__}.")
    return network
