"""Trained policies: checkpoint files, controllers, and exports to other formats."""
