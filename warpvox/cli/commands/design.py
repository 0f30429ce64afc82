"""``warpvox design``: serves the design editor to a browser on this machine."""

import webbrowser
from collections.abc import Collection
from pathlib import Path

from rich.console import Console

from warpvox.code import Code
from warpvox.configs.tools import DesignConfig
from warpvox.errors import ConfigError
from warpvox.io.console import echo
from warpvox.system import has_display


def check(config: DesignConfig, given: Collection[str]) -> None:
    """Raise ConfigError: the editor cannot be part of a sweep."""
    raise ConfigError("There is one editor at a time; --multirun has no meaning here.")


def run(config: DesignConfig, given: Collection[str], console: Console) -> None:
    """Run the command ``design``: serve the editor until Ctrl-C."""
    with console.status("starting"):
        from warpvox.devices.startup import prepare
        from warpvox.editor.server import EditorServer

        prepare(1, 0)
        server = EditorServer(Path(config.folder), config.port, config.file, [Code(task) for task in config.tasks])
    with server:
        echo(console, f"design editor: {server.url}")
        echo(console, f"files are opened and saved in {server.folder.resolve()}; Ctrl+C ends it")
        # without a screen a text browser might take over the terminal
        if config.browser == "on" or (config.browser == "auto" and has_display("DISPLAY", "WAYLAND_DISPLAY")):
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            echo(console, "stopped")
