"""A design search whose bodies are trained on the workers of Ray: python ray_search.py [address]

Without an address Ray is started on this machine; ``auto`` is the cluster that this machine belongs to. Needs the
extra ``ray``.
"""

import sys

import warpvox as wv


def main(address=None, workers=2, bodies=24, iterations=40):
    found = wv.codesign(
        "Walker-v0",
        search=wv.GA(population=8, max_designs=bodies),
        fitness=wv.Specialist(),
        training={"envs": 16, "iterations": iterations, "eval_interval": min(10, iterations)},
        executor="ray",
        address=address,
        workers=workers,
        batch=4,  # bodies that a worker trains together
        device="cpu",
    )
    print(found)
    return found


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
