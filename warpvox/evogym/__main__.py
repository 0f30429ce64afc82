"""``python -m warpvox.evogym SCRIPT [ARGUMENT ...]``: runs a script written for EvoGym, as ``python SCRIPT`` would."""

import argparse
import runpy
import sys
from pathlib import Path

from warpvox.evogym.switch import install_everywhere

__all__ = ["main"]


def main() -> None:
    """Run the script of the command line, in which ``import evogym`` means this package."""
    parser = argparse.ArgumentParser("python -m warpvox.evogym", description="Run a script written for EvoGym.")
    parser.add_argument("script", type=Path)
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="those of the script")
    script = parser.parse_args().script
    if not script.is_file():
        parser.error(f"there is no script {script}")
    sys.argv = sys.argv[1:]
    sys.path[0] = str(script.resolve().parent)
    install_everywhere()
    runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
