"""Progress of trainings and searches: on a terminal, in a notebook, and at Weights & Biases."""
