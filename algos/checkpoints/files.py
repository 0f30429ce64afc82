"""Checkpoint files: a policy with everything needed to rebuild it, written atomically."""

import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import torch
from rsl_rl.models import MLPModel, RNNModel
from tensordict import TensorDict

from warpvox.algos.expected import check_plain
from warpvox.algos.generators import Generators
from warpvox.algos.policies.gait import GaitModel
from warpvox.algos.policies.layout import VoxelLayout
from warpvox.algos.policies.model import VoxelModel
from warpvox.algos.settings import MAX_LAYERS, WIDEST, Ppo
from warpvox.code import Code, is_code
from warpvox.devices.startup import own_torch
from warpvox.envs.adapters.rsl_rl import OBS_GROUP
from warpvox.errors import RunError, SimulationError, first_line
from warpvox.io.writing import write_bytes
from warpvox.runs import BEST
from warpvox.types import ACTION_CENTER, ACTION_HIGH, ACTION_LOW

MAX_BYTES = 1 << 32
"""Maximum size of a checkpoint in bytes; the state of 65,536 environments takes a tenth."""
MAX_ENTRIES = 1 << 16
"""Maximum number of entries in a checkpoint."""
MAX_PICKLE_BYTES = 1 << 26
"""Maximum size of a checkpoint's content without its tensors, in bytes."""
RNN = {"rnn_type": "lstm", "rnn_hidden_dim": 256, "rnn_num_layers": 1}
"""Settings of rsl-rl's ``RNNModel`` with their defaults."""


@dataclass(frozen=True)
class PolicySpec:
    """Description of a policy's network, sufficient to rebuild it before loading weights.

    ``action_scale``, ``action_center``: of actions, center + scale * output.
    ``action_step``: actions in float64 are multiples of it; 0: they are float32.
    ``obs_eps``: what is added to the deviation of observations; the default is that of rsl-rl's normaliser.
    ``voxels``: of a policy for voxels, the ``network``, ``settings`` and ``layout`` that
    :class:`warpvox.algos.policies.model.VoxelModel` takes; None: fully connected layers.
    ``gait``: of an open-loop gait, the ``stages``, ``rows`` and ``columns`` that
    :class:`warpvox.algos.policies.gait.GaitModel` takes.
    ``rnn``: of recurrent layers before the others, what rsl-rl's ``RNNModel`` takes (:data:`RNN`).
    """

    num_obs: int
    num_actions: int
    hidden: list[int]
    activation: str
    normalize_obs: bool
    action_scale: float
    action_center: float = ACTION_CENTER
    action_step: float = 0.0
    obs_eps: float = 0.01
    voxels: dict[str, Any] | None = None
    gait: dict[str, int] | None = None
    rnn: dict[str, Any] | None = None

    @property
    def is_mlp(self) -> bool:
        """True if the policy consists of fully connected layers only."""
        return self.voxels is None and self.gait is None and self.rnn is None

    @property
    def has_feedback(self) -> bool:
        """True if actions depend on observations other than the time."""
        return self.gait is None


def actions_of(outputs: torch.Tensor, scale: float) -> torch.Tensor:
    """Convert the outputs of a policy to actions in [0.6, 1.6]."""
    return (ACTION_CENTER + scale * outputs).clamp(ACTION_LOW, ACTION_HIGH)


def save_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write ``content`` (tensors, numbers, texts, lists and dictionaries) to ``path`` atomically."""
    # Write to memory first: torch's own writer gives unclear errors for a full disk.
    whole = io.BytesIO()
    torch.save(content, whole)
    write_bytes(path, whole.getbuffer(), make_folders=False)


def read_tensors(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Read a file of :func:`save_checkpoint`, using no more memory than the file's size.

    torch loads tensors and plain values alone (``weights_only``). What they mean is checked by :func:`check_like`.
    """
    if not path.is_file():
        raise RunError(f"There is no checkpoint file {path}.")
    with open(path, "rb") as file:
        return tensors_in(file, path, device)


def tensors_in(file: BinaryIO, path: Path, device: str = "cpu") -> dict[str, Any]:
    """Read tensors from an open ``file`` as :func:`read_tensors` does; ``path`` names the file in errors."""
    try:
        with zipfile.ZipFile(file) as archive:
            _check_entries(file.seek(0, io.SEEK_END), archive.infolist())
            damaged = archive.testzip()  # torch does not compare checksums
        if damaged is not None:
            raise zipfile.BadZipFile(f"{damaged} is damaged")
        file.seek(0)
        content = torch.load(file, map_location=device, weights_only=True)
        check_plain(content)
    except Exception as error:  # whatever torch and pickle raise for what they cannot read
        others = path.name == BEST and any(path.parent.glob("model_[0-9]*.pt"))
        hint = " The run has others: checkpoint=last takes the newest." if others else ""
        raise RunError(f"{path} is not a readable checkpoint ({first_line(error):.120}).{hint}") from None
    if not isinstance(content, dict):
        raise RunError(f"{path} is not a checkpoint of warpvox.")
    return content


def _check_entries(size: int, entries: Sequence[zipfile.ZipInfo]) -> None:
    """Raise ValueError if a file of ``size`` bytes is too long, or would unpack to more bytes."""
    if size > MAX_BYTES or sum(entry.file_size for entry in entries) > size:
        raise ValueError(f"it is longer than {MAX_BYTES >> 30} GiB, or unpacks to more than its {size:,} bytes")
    if len(entries) > MAX_ENTRIES:
        raise ValueError(f"it has {len(entries):,} entries; {MAX_ENTRIES:,} are allowed")
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):  # torch packs nothing
        raise ValueError("its entries are packed")
    if any(entry.file_size > MAX_PICKLE_BYTES for entry in entries if entry.filename.endswith(".pkl")):
        raise ValueError(f"what it holds beside tensors is longer than {MAX_PICKLE_BYTES >> 20} MiB")


@contextmanager
def damaged(path: Path | None, hint: str = "") -> Iterator[None]:
    """Convert errors within the block to a RunError that calls the checkpoint ``path`` damaged.

    Without a ``path`` nothing comes from a file, and errors stay as they are.
    """
    if path is None:
        yield
        return
    try:
        yield
    except (RunError, SimulationError) as error:
        raise RunError(f"{path} cannot be gone on from: {first_line(error)}{hint}") from None
    except (TypeError, ValueError, ArithmeticError, RuntimeError, LookupError, AttributeError) as error:
        raise RunError(f"{path} is damaged ({type(error).__name__}: {first_line(error):.120}).{hint}") from None


def load_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Read a policy's checkpoint; RunError: no such file, damaged, or of another kind."""
    return checked_checkpoint(read_tensors(path, device), path)


def checked_checkpoint(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Verify that the ``content`` of a file is a policy's checkpoint, and return it; RunError: it is not."""
    if "policy" not in content or "actor_state_dict" not in content:
        raise RunError(f"{path} is not a checkpoint of warpvox: it holds no policy.")
    return content


def with_code(spec: PolicySpec, network: str | None) -> PolicySpec:
    """Replace code named in ``spec`` by the user's ``network``; RunError: the user named none."""
    if not isinstance(spec.voxels, dict) or not is_code(spec.voxels.get("network")):
        return spec
    if not isinstance(network, Code):
        name = str(spec.voxels["network"])
        raise RunError(f"The policy has a network of its own, {name!r:.80}: name it, policy=FILE.py:Class.")
    return replace(spec, voxels=spec.voxels | {"network": network})


def check_sizes(spec: PolicySpec) -> None:
    """Raise ValueError or TypeError if ``spec`` describes an impossible network."""
    for name in ("action_scale", "action_center", "action_step", "obs_eps"):
        value = getattr(spec, name)
        if type(value) not in (int, float) or not abs(value) < WIDEST:
            raise ValueError(f"{name} must be a number, got {value!r:.100}")
    layout = {k: size for k, size in (spec.voxels or {}).get("layout", {}).items() if k not in ("timed", "periods")}
    rnn = dict(spec.rnn or {})
    if rnn and (rnn.keys() != RNN.keys() or rnn.pop("rnn_type") not in ("lstm", "gru")):
        raise ValueError(f"recurrent layers must be described by {', '.join(RNN)}, got {spec.rnn!r:.100}")
    sizes = [spec.num_obs, spec.num_actions, *spec.hidden, *(spec.gait or {}).values(), *layout.values(), *rnn.values()]
    if not all(type(size) is int and 0 <= size <= WIDEST for size in sizes):
        raise ValueError(f"sizes must be integers up to {WIDEST:,}, got {sizes!r:.100}")
    settings = (spec.voxels or {}).get("settings", {})
    depths = [len(spec.hidden), rnn.get("rnn_num_layers", 1), settings.get("layers", 1)]
    if not all(type(depth) is int and depth <= MAX_LAYERS for depth in depths):
        raise ValueError(f"a network has {MAX_LAYERS} layers at most, got {max(map(str, depths), key=len):.20}")
    if not all(size <= WIDEST for size in settings.values() if isinstance(size, int | float)):
        raise ValueError(f"sizes must be integers up to {WIDEST:,}, got {settings!r:.100}")
    if spec.voxels is not None:
        layout = VoxelLayout(**spec.voxels["layout"])
        if (layout.num_obs, layout.actions) != (spec.num_obs, spec.num_actions):
            raise ValueError("the layout is that of other observations or actions")


def check_spec(spec: PolicySpec, weights: object) -> None:
    """Raise ValueError or TypeError unless ``weights`` fit the network of ``spec``; exploration may be missing."""
    check_sizes(spec)
    weights = checked_weights(weights)
    expected = build_actor(spec, "meta").state_dict()
    if not any(name.startswith("distribution.") for name in weights):
        expected = {name: value for name, value in expected.items() if not name.startswith("distribution.")}
    for name in [*expected, *(name for name in weights if name not in expected)]:
        want, got = (tuple(of[name].shape) if name in of else "missing" for of in (expected, weights))
        if want != got or expected[name].is_floating_point() != weights[name].is_floating_point():
            raise ValueError(f"the weights are those of another network: {name!s:.40} is {got}, not {want}")
    if spec.gait is not None:
        cells = weights["cells"].long()
        last = spec.gait["rows"] * spec.gait["columns"]
        if not bool((cells[1:] > cells[:-1]).all() & (cells >= 0).all() & (cells < last).all()):
            raise ValueError(f"the cells of a gait must rise, from 0 to {last - 1}; got {cells.tolist()!r:.100}")
        if not bool((weights["period"] > 0).all()):
            raise ValueError("the periods of a gait must be above 0")
        begin = weights["begin"]
        if bool(begin[0] != 0) or bool((begin.diff() < 0).any()):
            raise ValueError(f"begin of a gait must start with 0 and never decrease; got {begin.tolist()!r:.100}")


def checked_weights(weights: object) -> dict[str, torch.Tensor]:
    """Return ``weights`` if they are plain finite tensors by name; ValueError: they are not."""
    is_plain = lambda one: isinstance(one, torch.Tensor) and not one.is_meta and not one.is_quantized  # noqa: E731
    if not isinstance(weights, dict) or not all(map(is_plain, weights.values())):
        raise ValueError("the weights are no tensors")
    if not all(value.layout == torch.strided and value.is_contiguous() for value in weights.values()):
        raise ValueError("the weights are views of other tensors")  # one number can pose as a million
    if not all(bool(torch.isfinite(value).all()) for value in weights.values()):
        raise ValueError("the weights are not finite numbers")
    return weights


def build_actor(spec: PolicySpec, device: str = "cpu") -> MLPModel | GaitModel:
    """Build the network described by ``spec``, with weights still to be loaded."""
    with own_torch(), Generators(0), torch.device(device):
        if spec.gait is not None:
            return GaitModel(spec.num_actions, **spec.gait)
        obs = TensorDict({OBS_GROUP: torch.zeros(1, spec.num_obs)}, batch_size=[1])
        places = (obs, {"actor": [OBS_GROUP]}, "actor", spec.num_actions)
        noise = {"class_name": "GaussianDistribution", "std_type": "log"}
        own = {"obs_normalization": spec.normalize_obs, "distribution_cfg": noise}
        if spec.voxels is not None:
            return VoxelModel(*places, **spec.voxels, **own)
        layers = {"hidden_dims": list(spec.hidden), "activation": spec.activation}
        return (RNNModel if spec.rnn else MLPModel)(*places, **layers, **own, **(spec.rnn or {}))


def spec_of(values: Mapping[str, Any]) -> PolicySpec:
    """Return the specification stored in a checkpoint; TypeError: missing, or with other entries."""
    if not isinstance(values, Mapping):
        raise TypeError(f"it is described by {values!r:.40}")
    return PolicySpec(**values)


def spec_for(ppo: Ppo, num_obs: int, num_actions: int, **kind: Any) -> PolicySpec:
    """Return the specification of a policy trained with the settings ``ppo``."""
    sizes = num_obs, num_actions, list(ppo.hidden), ppo.activation
    return PolicySpec(*sizes, ppo.normalize_obs, ppo.action_scale, **kind)


def check_fits(ours: PolicySpec, pretrained: PolicySpec) -> None:
    """Raise RunError unless a pretrained policy has the sizes of ``ours``, for the present environments."""
    names = ["action_scale", "normalize_obs"]
    names += ["num_obs", "num_actions", "hidden", "activation", "rnn"] if ours.voxels is None else []
    sizes = [(name, getattr(ours, name), getattr(pretrained, name)) for name in names]
    if ours.voxels is not None:
        layouts = ours.voxels["layout"], (pretrained.voxels or {}).get("layout", {})
        sizes = [(f"layout ({key})", *(one.get(key) for one in layouts)) for key in layouts[0] | layouts[1]] + sizes
    for name, wanted, found in sizes:
        if wanted != found:
            how = "Take the task and bodies that it was trained for, or others of the same sizes."
            raise RunError(f"The pretrained policy has another {name}: {found}, here it is {wanted}. {how}")


def spec_dict(spec: PolicySpec) -> dict[str, Any]:
    """Convert a specification to a dictionary for a checkpoint."""
    values = {name: value for name, value in asdict(spec).items() if value is not None}
    if spec.voxels is not None:  # code is stored by its name, as plain text
        values["voxels"] |= {"network": str(spec.voxels["network"])}
    return values
