"""Import all of warpvox and run commands as on a system that is not Linux; run by ``test_system.py`` as a process.

What only Linux has is taken away once the libraries are loaded, whose own ways with systems are not ours to test.
"""

import builtins
import os
import pkgutil
import signal
import sys
from importlib import import_module
from typing import Any

LATER = ("pxr.Usd", "tkinter", "torch.utils.tensorboard", "imageio_ffmpeg", "rsl_rl.runners", "PIL.PngImagePlugin")
"""Libraries that commands import while they run."""
MISSING = {"fcntl", "resource", "termios", "tty", "pty", "pwd", "grp", "syslog", "posix", "curses", "readline"}
NAMES = {
    os: ("sched_getaffinity", "fork", "sysconf", "getuid", "geteuid", "killpg", "setsid", "getpgid", "uname", "nice"),
    signal: ("SIGHUP", "SIGKILL", "SIGQUIT", "SIGUSR1", "SIGPIPE", "SIGALRM", "alarm", "pthread_sigmask"),
}


def import_all() -> None:
    import warpvox

    packages = ("kernels", "envs", "algos", "configs")  # they lie beside the package in a checkout
    own = pkgutil.iter_modules(warpvox.__path__[:1], "warpvox.")
    for name in [*(module.name for module in own), *(f"warpvox.{name}" for name in packages)]:
        top = import_module(name) if not name.endswith("__main__") else None
        for module in pkgutil.walk_packages(getattr(top, "__path__", []), f"{name}."):
            if not module.name.endswith(("__main__", "reference_worker")):
                import_module(module.name)


def pretend(platform: str) -> None:
    """Take away what only Linux has, from warpvox alone where others still need it."""
    importing = builtins.__import__

    def refuse(name: str, globals: Any = None, *more: Any, **words: Any) -> Any:
        ours = str((globals or {}).get("__name__", "")).startswith("warpvox")
        if ours and name.partition(".")[0] in MISSING:
            raise ImportError(f"no {name} on {platform}")
        return importing(name, globals, *more, **words)

    builtins.__import__ = refuse
    for module, names in NAMES.items():
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    sys.platform = platform
    for name in [name for name in sys.modules if name.partition(".")[0] == "warpvox"]:
        del sys.modules[name]


def main(platform: str, *training: str) -> None:
    """Import, pretend to be another system, import again and run, a training first."""
    import_all()
    for name in LATER:
        import_module(name)
    import warp

    warp.init()
    pretend(platform)
    import_all()
    from warpvox import system
    from warpvox.cli import main as command

    assert (platform == "win32") == system.WINDOWS
    assert (system.available_memory() or 1) > 0
    assert system.has_display()
    assert system.usable_cores() >= 1
    assert command(training) == 0
    assert command(["train", "resume=latest", "max_iterations=2"]) == 0
    assert command(["play", "window=off", "steps=3", "num_envs=1", "threads=1", "export=[png]"]) == 0
    assert command(["info"]) == 0


if __name__ == "__main__":
    main(*sys.argv[1:])
