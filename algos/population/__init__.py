"""Training of many policies in one batch, one for each design."""
