"""``warpvox design``: the design editor in the browser, served to this machine only."""

import webbrowser
from pathlib import Path

from rich.console import Console

from warpvox.cli.application import run_command
from warpvox.code import Code
from warpvox.configs.tools import DesignConfig
from warpvox.errors import ConfigError
from warpvox.io.console import echo
from warpvox.system import has_display


def run(words: list[str]) -> None:
    run_command("design", words, serve, check=_only_one)


def _only_one(_: object) -> None:
    raise ConfigError("There is one editor at a time; --multirun has no meaning here.")


def serve(config: DesignConfig, console: Console) -> None:
    """Serve the editor until it is interrupted."""
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
