"""``warpvox demo``: from nothing to a walking robot that can be looked at; ``warpvox train preset=demo``."""

from warpvox.cli.commands import train


def run(words: list[str]) -> None:
    """Train, record the best policy, export it, and say where everything is."""
    train.run(["preset=demo", *words])
