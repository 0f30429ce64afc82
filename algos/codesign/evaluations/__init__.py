"""Ways to compare the designs of a search, each with its settings, checks and costs; one file each."""

from warpvox.algos.codesign.evaluations.base import Evaluation
from warpvox.algos.codesign.evaluations.custom import Custom
from warpvox.algos.codesign.evaluations.gaits import Gaits
from warpvox.algos.codesign.evaluations.specialist import Specialist

__all__ = ["EVALUATIONS", "Custom", "Evaluation", "Gaits", "Specialist"]

EVALUATIONS: dict[str, type[Evaluation]] = {one.name: one for one in (Specialist, Gaits, Custom)}
"""The evaluations by name."""
