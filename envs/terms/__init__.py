"""Terms: small functions of states, from which observations, rewards and terminations of tasks are built."""
