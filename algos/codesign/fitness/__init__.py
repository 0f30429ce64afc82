"""Ways to find the fitness of designs, each with its settings, checks and costs; one file each."""

from warpvox.algos.codesign.fitness.custom import Custom
from warpvox.algos.codesign.fitness.gaits import Gaits
from warpvox.algos.codesign.fitness.specialist import Specialist
from warpvox.algos.codesign.settings import Fitness

__all__ = ["Custom", "Fitness", "Gaits", "Specialist"]
