"""Record the digests of this platform: ``python tests/determinism/record.py`` (a minute; commit what it has changed).

Other platforms' records are kept. Where the results of a platform change on purpose, all records must be made anew:
remove those that cannot be.
"""

import json

import torch
from pins import FILE, load, this_platform
from rollouts import digests

from warpvox.envs.registry import task_ids
from warpvox.io.writing import write_text


def main() -> None:
    torch.set_num_threads(1)
    here = this_platform()
    others = [record for record in (load() if FILE.exists() else []) if record["platform"] != here]
    records = [*others, {"platform": here, "digests": digests(task_ids())}]
    write_text(FILE, json.dumps(records, indent=1) + "\n")
    print(f"{FILE.name}: {len(records)} platform(s), of this one: {here}")


if __name__ == "__main__":
    main()
