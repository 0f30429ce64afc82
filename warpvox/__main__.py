"""``python -m warpvox`` is the command ``warpvox``."""

from warpvox.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
