"""The command line: ``warpvox COMMAND [KEY=VALUE ...]``.

Each command is a module of :mod:`warpvox.cli.commands`, imported when it is asked for. Its function
``run(settings, given, console)`` gets the settings, the keys that the user has given and where to print; it returns the
folder that it has made, if any. ``check(settings, given)``, where there is one, finds mistakes in a moment. The modules
beside this one are what commands share; only they and :mod:`warpvox.configs` import Hydra.

Exit codes: 0 done, 2 bad usage, bad input or a machine that will not (one line on stderr), 130 interrupted by Ctrl-C,
143 asked to end (SIGTERM), 129 its terminal was closed (SIGHUP).
"""

import errno
import signal
import sys
from collections.abc import Sequence
from importlib import import_module

import warpvox
from warpvox.algos.interrupt import Terminated, terminable
from warpvox.cli.streams import lasting_output, redirect
from warpvox.devices.out_of_memory import enough_memory
from warpvox.errors import ConfigError, ResumeError, WarpvoxError, did_you_mean
from warpvox.io.writing import OF_DISKS, complaint
from warpvox.system import unquoted

__all__ = ["COMMANDS", "main"]

COMMANDS = {
    "train": "train a controller for a body on a task",
    "codesign": "search for a body and its controller at once",
    "play": "watch a trained controller or a simple agent, print returns, export what it did",
    "export": "write a run's rollout as USD, film, pictures or page",
    "evaluate": "mean returns of trained policies with confidence intervals, and how they compare",
    "curves": "draw the learning curves of runs as one picture",
    "design": "paint a body or a world in the browser, save it, try it out",
    "demo": "train a walker in a minute or two and export it: warpvox train preset=demo",
    "zoo": "list the trained robots that come with warpvox, or show one",
    "tasks": "list the tasks, or show one in detail",
    "info": "versions, devices, kernel cache",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that ``argv`` names; return the exit code.

    Args:
        argv: arguments without the program's name; None: those of the process.
    """
    name, *words = [*map(unquoted, sys.argv[1:] if argv is None else argv)] or [""]
    # Commands that make files continue when the reader of their output has gone, and say so.
    gone = None
    if name in ("train", "codesign", "play", "export", "demo"):
        gone = "warpvox: nobody reads the output any more; going on without it"
    with lasting_output(gone):
        try:
            with terminable(), enough_memory("Ask for less at once, such as a smaller num_envs."):
                code = 0
                if name in ("", "-h", "--help", "help"):
                    commands = "\n".join(f"  {command:<8} {meaning}" for command, meaning in COMMANDS.items())
                    text = (
                        f"usage: warpvox COMMAND [KEY=VALUE ...]\n\n{commands}\n\n"
                        "`warpvox COMMAND --help` lists the keys of a command; `warpvox -sc install=bash` prints code"
                        " that completes\nthem in bash (zsh, fish). For instance:\n"
                        "  warpvox train task=Walker-v0 design=walker num_envs=512\n"
                        "  warpvox play run=latest 'export=[usd,gif,html]'"
                    )
                    print(text, file=sys.stdout if name else sys.stderr)
                    code = 0 if name else 2
                elif name in ("-V", "--version", "version"):
                    print(f"warpvox {warpvox.__version__}")
                elif name in ("-sc", "--shell-completion"):
                    from warpvox.cli.sweep import complete

                    complete(words, COMMANDS)
                elif name not in COMMANDS:
                    hint = did_you_mean(name, COMMANDS)
                    raise ConfigError(f"Unknown command '{name}'; there are {', '.join(COMMANDS)}.{hint}")
                else:
                    if name == "demo":
                        name = "train"
                        words = ["preset=demo", *words]
                    from warpvox.cli.application import read_command
                    from warpvox.io.console import make_console

                    asked = read_command(name, COMMANDS[name], words)
                    if asked is not None:
                        settings, given = asked
                        import_module(f"warpvox.cli.commands.{name}").run(settings, given, make_console())
                sys.stdout.flush()  # here a full disk can still be reported
                return code
        except ResumeError as error:
            from warpvox.io.text import shell_argument

            changes = [f"{key}={'null' if value is None else value}" for key, value in error.changes.items()]
            command = " ".join(["warpvox train", shell_argument("resume", error.resume), *changes])
            return _print_error(f"{error} Go on with: {command}")
        except WarpvoxError as error:
            return _print_error(error)
        except Terminated as request:
            print(f"warpvox: asked to end ({signal.Signals(request.number).name})", file=sys.stderr)
            return 128 + request.number
        except KeyboardInterrupt:
            print("warpvox: interrupted", file=sys.stderr)
            return 130
        except PermissionError as error:
            return _print_error(f"Permission is denied: {error.filename or error}. Name a place that you may use.")
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                return _print_error(
                    f"No file or folder can have the name '{error.filename!s:.100}...': it is too long."
                )
            if error.errno not in OF_DISKS:
                raise
            redirect(sys.stdout)
            where = str(error.filename or "The output")
            hint = " WARP_CACHE_PATH=FOLDER is where Warp keeps kernels." if "cache" in where.lower() else ""
            return _print_error(f"{where} cannot be written: {complaint(error)}.{hint}")


def _print_error(error: WarpvoxError | str) -> int:
    """Print an error as one line on standard error, and return exit code 2."""
    from warpvox.io.text import escaped

    # one line, with the blanks of paths as they are
    text = " ".join(line.strip() for line in str(error).splitlines())
    print(f"warpvox: {escaped(text)}", file=sys.stderr)
    return 2
