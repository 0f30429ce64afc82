"""``python -m warpvox.evogym SCRIPT [ARGUMENT ...]``: runs a script written for EvoGym, as ``python SCRIPT`` would.

``python -m warpvox.evogym -m MODULE [ARGUMENT ...]`` runs a module, ``-m pytest`` for instance.
"""

import argparse
import importlib.util
import runpy
import sys
import traceback
from pathlib import Path

from warpvox.evogym.switch import install_everywhere

__all__ = ["main"]

_OLD_GYM = (
    "warpvox.evogym: EvoGym 2.0 uses gymnasium. Write import gymnasium as gym and import evogym.envs; reset() returns"
    " two values, obs and info, step() five: obs, reward, terminated, truncated, info."
)


def main() -> None:
    """Run the script of the command line, in which ``import evogym`` means this package."""
    parser = argparse.ArgumentParser("python -m warpvox.evogym", description="Run a script written for EvoGym.")
    parser.add_argument("-m", action="store_true", dest="is_module", help="SCRIPT is the name of a module")
    parser.add_argument("script")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="those of the script")
    options = parser.parse_args()
    script = options.script
    if not options.is_module and not Path(script).is_file():
        parser.error(f"there is no script {script}")
    if options.is_module and importlib.util.find_spec(script.partition(".")[0]) is None:
        parser.error(f"there is no module {script}")
    sys.argv = [script, *options.arguments]
    install_everywhere()
    try:
        if options.is_module:
            runpy.run_module(script, run_name="__main__", alter_sys=True)
        else:
            sys.path[0] = str(Path(script).resolve().parent)
            runpy.run_path(script, run_name="__main__")
    except Exception as error:
        is_unpacked = isinstance(error, ValueError) and "values to unpack (expected 4" in str(error)
        if getattr(error, "name", None) == "gym" or type(error).__name__ == "NameNotFound" or is_unpacked:
            traceback.print_exc()
            sys.exit(_OLD_GYM)
        raise


if __name__ == "__main__":
    main()
