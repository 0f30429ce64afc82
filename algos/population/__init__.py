"""Training of many policies in one batch, one per design."""
