"""Ways to evaluate the designs of a search, each with its settings, checks and costs; one file each."""

from warpvox.algos.codesign.evaluations.custom import Custom
from warpvox.algos.codesign.evaluations.gaits import Gaits
from warpvox.algos.codesign.evaluations.specialist import Specialist
from warpvox.algos.codesign.settings import Evaluation

__all__ = ["Custom", "Evaluation", "Gaits", "Specialist"]
