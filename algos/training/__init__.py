"""Training of one policy: PPO, networks, the runner and its metrics."""
