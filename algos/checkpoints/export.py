"""Export of policies to ONNX and TorchScript, verified against the original policy.

Both also contain :func:`warpvox.algos.checkpoints.policy.policy_bytes`, from which :func:`read_exported` rebuilds the
policy: reading such a file never runs the program in it.
"""

import base64
import binascii
import contextlib
import copy
import io
import logging
import os
import warnings
import zipfile
import zlib
from collections.abc import Callable, Container, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warpvox.algos.checkpoints.files import checked_checkpoint, tensors_in
from warpvox.algos.checkpoints.policy import Policy, policy_bytes, policy_of
from warpvox.errors import RunError
from warpvox.io.reading import Unreadable, read_bytes
from warpvox.io.writing import atomic_path, check_suffix

CARD = "warpvox.pt"
"""Name of the file's entry that contains the policy as a checkpoint, in base64 in ONNX files."""
OLD_CARD = "warpvox.json"
"""Name of the policy's entry in files of warpvox 0.1."""
LARGEST = 1 << 28
"""Maximum size of the policy in an exported file, in bytes."""
ROWS = (1, 64)
"""Sizes of the two random batches of observations used to verify an exported file."""
TOLERANCE = 1e-5
"""Largest allowed difference of actions (range 1.0), as runtimes sum products in different orders."""

Runner = Callable[[np.ndarray], np.ndarray]


def write_script(policy: Policy, path: str | os.PathLike[str]) -> str:
    """Export a policy as TorchScript; return, as text, how the file was verified.

    ``torch.jit.load(path)(obs)``, or ``torch::jit::load`` in C++, takes ``[..., num_obs]``; of a policy for voxels
    ``[batch, num_obs]``.

    Raises:
        RunError: another suffix than .pt, .pth or .ts, or a file that does not do what the policy does; it is not kept.
        StorageError: it cannot be written.
    """
    check_suffix("A file of TorchScript", path, (".pt", ".pth", ".ts"), RunError)
    policy = _copied(policy)
    whole = io.BytesIO()
    with atomic_path(path, follow=True) as temporary, _quiet():
        if policy.spec.voxels is None and policy.spec.gait is None:
            program = torch.jit.script(policy)
        else:  # networks of the user's may not be scriptable
            program = torch.jit.trace(policy, torch.zeros(2, policy.num_obs))
        torch.jit.save(program, whole, _extra_files={CARD: policy_bytes(policy)})
        temporary.write_bytes(whole.getbuffer())  # torch's own writer gives unclear errors for a full disk
        module = torch.jit.load(str(temporary))
        return _compare(policy, lambda obs: module(torch.from_numpy(obs)).numpy(), temporary, path)


def _copied(policy: Policy) -> Policy:
    """Copy the policy to the CPU; RunError: recurrent policies cannot be exported."""
    if policy.spec.rnn is not None:
        raise RunError("A recurrent policy is not exported: warpvox.load_policy() gives it as a torch module.")
    return copy.deepcopy(policy).cpu()


def write_onnx(policy: Policy, path: str | os.PathLike[str]) -> str:
    """Export a policy as one ONNX file; return, as text, how the file was verified.

    Input ``obs`` float32 ``[batch, num_obs]``, output ``actions`` float32 ``[batch, num_actions]``. Compared by
    ONNX Runtime where it is installed, else by the reference evaluator of the package onnx.

    Raises:
        RunError: another suffix than .onnx, the package onnx is missing, or the file does not do what the policy does;
            it is not kept. StorageError: it cannot be written.
    """
    check_suffix("An ONNX file", path, (".onnx",), RunError)
    if find_spec("onnx") is None or find_spec("onnxscript") is None:
        raise RunError("ONNX needs the packages onnx and onnxscript: pip install 'warpvox[export]'.")
    import onnx

    policy = _copied(policy)
    with atomic_path(path, follow=True) as temporary, _quiet():
        program = torch.onnx.export(
            policy,
            (torch.zeros(2, policy.num_obs),),  # with one row torch may treat the number of rows as fixed
            input_names=["obs"],
            output_names=["actions"],
            dynamic_shapes={"obs": {0: torch.export.Dim("batch")}},
            dynamo=True,
            verbose=False,
        )
        assert program is not None  # only torch's earlier exporter returns None
        model = program.model_proto
        onnx.helper.set_model_props(model, {CARD: base64.b64encode(policy_bytes(policy)).decode()})
        onnx.checker.check_model(model)
        temporary.write_bytes(model.SerializeToString())
        name, run = _onnx_runner(temporary)
        return f"{_compare(policy, run, temporary, path)} by {name}"


POLICY_WRITERS = {"onnx": ("policy.onnx", write_onnx), "jit": ("policy.pt", write_script)}
"""File name and export function of each format."""


def read_exported(path: Path, network: str | None = None) -> Policy | None:
    """Read the policy from a file of :func:`write_onnx` or :func:`write_script`; None: another kind of file.

    ``network``: as for :func:`warpvox.algos.checkpoints.policy.read_policy`.
    """
    card = _card_of_onnx(path) if path.suffix.lower() == ".onnx" else _card_of_script(path)
    if card is None:
        return None
    content = checked_checkpoint(tensors_in(io.BytesIO(card), path), path)
    return policy_of(content, path, network)


def _card_of_onnx(path: Path) -> bytes:
    """Extract the policy's bytes from an ONNX file; RunError: unreadable or without a policy."""
    if find_spec("onnx") is None:
        raise RunError(f"To read {path} the package onnx is needed: pip install 'warpvox[export]'.")
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.ModelProto.FromString(read_bytes(path, LARGEST))
        found = {entry.key: entry.value for entry in model.metadata_props}
        _refuse_other_writers(path, found)
        if CARD not in found:
            raise RunError(f"{path} was not written by warpvox: it does not say which policy it holds.")
        return base64.b64decode(found[CARD], validate=True)
    except (Unreadable, DecodeError, binascii.Error) as error:
        raise RunError(f"{path} is not an ONNX file that can be read ({error}).") from None


def _card_of_script(path: Path) -> bytes | None:
    """Extract the policy's bytes from a TorchScript file; None: no policy in the file."""
    if not zipfile.is_zipfile(path):
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            extra = {info.filename.rpartition("/extra/")[2]: info for info in archive.infolist()}
            _refuse_other_writers(path, extra)
            if CARD not in extra:
                return None
            if extra[CARD].file_size > LARGEST or extra[CARD].compress_type != zipfile.ZIP_STORED:
                raise RunError(f"{path} holds no policy that can be read (it is too long or packed).")
            return archive.read(extra[CARD])
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError) as error:  # as damaged or encrypted
        raise RunError(f"{path} holds no policy that can be read ({error}).") from None


def _refuse_other_writers(path: Path, names: Container[str]) -> None:
    """Raise RunError if a file was exported by another library or by warpvox 0.1.0."""
    if "_stable_baselines3_version" in names:
        raise RunError(
            f"{path} is a file of Stable-Baselines3. Load it by model = PPO.load(...) and evaluate a function of"
            " observations: lambda obs: 1.1 + 0.5 *"
            " torch.as_tensor(model.predict(obs.cpu().numpy(), deterministic=True)[0])."
            " The actions of VoxelSB3VecEnv, -1 to 1, stand for 0.6 to 1.6."
        )
    if OLD_CARD in names:
        raise RunError(f"{path} was exported by warpvox 0.1.0: export the policy again from its run.")


def _onnx_runner(path: Path) -> tuple[str, Runner]:
    """Load an ONNX file into a runtime; return the runtime's name and a function from observations to actions."""
    run: Callable[..., Any]
    if find_spec("onnxruntime") is not None:
        import onnxruntime

        name = "ONNX Runtime"
        run = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run
    else:
        from onnx.reference import ReferenceEvaluator

        name = "onnx's reference evaluator"
        run = ReferenceEvaluator(str(path)).run
    return name, lambda obs: run(None, {"obs": obs})[0]


def _compare(policy: Policy, run: Runner, written: Path, path: object) -> str:
    """Compare a written file with the policy; RunError: they differ. Return the largest difference as text.

    ``run`` calls the program in the temporary file ``written``, which will be renamed to ``path``.
    """
    generator = torch.Generator().manual_seed(0)
    apart = 0.0
    for rows in ROWS:
        obs = policy.network.random_obs(rows, generator)
        theirs = run(obs.numpy())
        ours = policy.act(obs.numpy())
        if theirs.shape != ours.shape or not np.isfinite(theirs).all():
            raise RunError(f"{path} is not kept: it gives {theirs.shape} where the policy gives {ours.shape} actions.")
        apart = max(apart, float(np.abs(theirs - ours).max()))
    if apart > TOLERANCE:
        raise RunError(f"{path} is not kept: its actions differ from the policy's by {apart:.2g}.")
    again = read_exported(written, (policy.spec.voxels or {}).get("network"))
    known = {} if again is None else again.state_dict()
    if not all(name in known and torch.equal(value, known[name]) for name, value in policy.state_dict().items()):
        raise RunError(f"{path} is not kept: the policy that it describes is another one.")
    return f"within {apart:.1e} of the policy"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence torch's warnings about optional packages and future changes within the block."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
