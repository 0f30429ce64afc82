"""Policies of a design search: one folder per evaluated design, laid out like a training run."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.checkpoints.files import (
    check_spec,
    checked_weights,
    damaged,
    load_checkpoint,
    save_checkpoint,
    spec_dict,
    spec_for,
    spec_of,
)
from warpvox.algos.settings import Ppo
from warpvox.code import is_code
from warpvox.io.writing import check_folder, write_text, writing
from warpvox.runs import BEST

_DESIGNS = "designs"
"""Subfolder of a search with one folder per design."""


class StoredPolicies:
    """Store of policies in ``designs/<id>/``: ``model_best.pt``, and ``config.yaml`` to play it.

    ``config`` returns the text of ``config.yaml`` for a candidate and its outcome.
    """

    def __init__(self, folder: Path, ppo: Ppo, config: Callable[[Candidate, Outcome], str]) -> None:
        self.folder = folder
        self.ppo = ppo
        self.config = config
        with writing(folder / _DESIGNS):
            (folder / _DESIGNS).mkdir(exist_ok=True)

    def save(self, candidate: Candidate, outcome: Outcome) -> tuple[str, str]:
        """Write an outcome's policy; return the path relative to the search's folder, and the SHA-256."""
        check_folder(self.folder / _DESIGNS)
        policy = outcome.policy or {}
        place = Path(_DESIGNS) / str(candidate.id)
        # the sizes of the first and last layer are those of the body, which the settings do not know
        layers = [value for name, value in policy.items() if name.startswith("mlp.") and name.endswith(".weight")]
        content = {
            "policy": outcome.spec or spec_dict(spec_for(self.ppo, layers[0].shape[1], layers[-1].shape[0])),
            "actor_state_dict": {name: value.detach().cpu() for name, value in policy.items()},
            "eval_return": outcome.fitness,
            "infos": {"candidate": candidate.id, "steps": outcome.steps},
        }
        write_text(self.folder / place / "config.yaml", self.config(candidate, outcome))
        save_checkpoint(self.folder / place / BEST, content)
        return (place / BEST).as_posix(), policy_sha256(policy)

    def load(self, path: str) -> dict[str, Any]:
        """Read a policy written by :meth:`save`; RunError: the file is damaged."""
        content = load_checkpoint(self.folder / path)
        with damaged(self.folder / path):
            spec = spec_of(content["policy"])
            if is_code((spec.voxels or {}).get("network")):  # what a file names is not imported
                checked_weights(content["actor_state_dict"])
            else:
                check_spec(spec, content["actor_state_dict"])
        return content["actor_state_dict"]


def policy_sha256(policy: Mapping[str, torch.Tensor]) -> str:
    """Return the SHA-256 of a policy's tensors (names, types, shapes, values), independent of the file."""
    total = hashlib.sha256()
    for name, value in policy.items():
        array = value.detach().cpu().contiguous().numpy()
        total.update(f"{name} {array.dtype} {array.shape} ".encode())
        total.update(array.tobytes())
    return total.hexdigest()
