"""Unpacks warpvox on a GPU machine without a package index: ``python3 install.py [FOLDER]``, beside the pack's parts.

Needs Python's standard library alone. Says what to add to PYTHONPATH, and what the machine lacks.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import lzma
import sys
import tarfile
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent


def unpack(parts: Path, target: Path) -> list[str]:
    """Join the parts of a pack, check and unpack them into ``target``; returns the modules that are missing here."""
    contents = json.loads((parts / "contents.json").read_text())
    with tempfile.TemporaryFile() as joined:
        for name, digest in contents["parts"].items():
            if not (parts / name).is_file():
                sys.exit(f"The part {name} is missing in {parts}; the pack has {', '.join(contents['parts'])}.")
            data = (parts / name).read_bytes()
            if hashlib.sha256(data).hexdigest() != digest:
                sys.exit(f"The part {name} is damaged: its SHA-256 is not that of contents.json.")
            joined.write(data)
        joined.seek(0)
        target.mkdir(parents=True, exist_ok=True)
        with lzma.open(joined) as stream, tarfile.open(fileobj=stream, mode="r|") as archive:
            archive.extractall(target, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    sys.path.insert(0, str(target))
    wanted, here = contents["python"], ".".join(map(str, sys.version_info[:2]))
    if wanted != here:
        print(f"This is Python {here}; the pack was made for {wanted}: compiled modules may not load.")
    return [name for name in contents["needs"] if importlib.util.find_spec(name) is None]


def main() -> None:
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "/tmp/warpvox_site").resolve()
    missing = unpack(HERE, target)
    print(f"export PYTHONPATH={target} PYTHONUNBUFFERED=1")
    if missing:
        sys.exit(f"This machine lacks {', '.join(missing)}, which the pack does not bring.")
    print("python3 -m warpvox.cli.gpu_check")


if __name__ == "__main__":
    main()
