"""Command lines that run within a moment."""

SEARCH = (
    "shape=[3,3] search.population=3 training.envs=8 training.iterations=1 training.eval_interval=1"
    " training.ppo.steps=4 training.ppo.hidden=[8] training.ppo.epochs=1"
)
WORDS = {
    "train": "design=mini num_envs=8 max_iterations=1 eval_interval=2 ppo.steps=4 ppo.hidden=[8] ppo.epochs=1",
    "codesign": f"{SEARCH} search.max_designs=5",
}


def once(*words: str) -> list[str]:
    """Remove repeated keys from words, keeping the last."""
    return list({word.split("=")[0]: word for word in words}.values())


def tiny(command: str, *words: str) -> list[str]:
    """Build a small command for one CPU thread, with changes in ``words``."""
    return [command, *once("device=cpu", "threads=1", *WORDS[command].split(), *words)]
