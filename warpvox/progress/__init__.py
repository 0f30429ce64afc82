"""Listeners of trainings and design searches: on a terminal, in a notebook, at Weights & Biases."""
