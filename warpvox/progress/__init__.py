"""Listeners that show the progress of trainings and searches: on a terminal, in a notebook, at Weights & Biases."""
