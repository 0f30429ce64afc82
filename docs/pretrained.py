"""Writes the policy that comes with warpvox: ``python docs/pretrained.py RUN``, a run of ``preset=universal_cpg``.

Not part of the library. What only goes on with the same training is left out: the optimiser's moments.
"""

import sys
from pathlib import Path

import yaml

from warpvox.algos.checkpoints.files import load_checkpoint, save_checkpoint
from warpvox.algos.codesign.evaluations.common import STEPS
from warpvox.algos.training.pretrained import UNIVERSAL_FILE
from warpvox.runs import CONFIG


def main(run: str) -> None:
    """Write it from the best checkpoint of a run."""
    content = load_checkpoint(Path(run) / "model_best.pt")
    config = yaml.safe_load((Path(run) / CONFIG).read_text(encoding="utf-8"))
    content[STEPS] = content["iter"] * config["num_envs"] * config["ppo"]["steps"]
    content["optimizer_state_dict"]["state"] = {}
    save_checkpoint(UNIVERSAL_FILE, content)
    print(f"{UNIVERSAL_FILE}: {UNIVERSAL_FILE.stat().st_size / 1e6:.2f} MB, return {content['eval_return']:.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
