"""Kinds of evaluation for the designs of a search, one file each, with settings, checks and costs."""

from warpvox.algos.codesign.evaluations.custom import Custom
from warpvox.algos.codesign.evaluations.gaits import Gaits
from warpvox.algos.codesign.evaluations.specialist import Specialist
from warpvox.algos.codesign.settings import Evaluation

__all__ = ["Custom", "Evaluation", "Gaits", "Specialist"]
