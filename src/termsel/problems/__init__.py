"""Problems: genes to objectives."""

from termsel.problems.base import Evaluation, Problem, Selection
from termsel.problems.genome import Genome
from termsel.problems.segments import Bits, Segment

__all__ = ["Bits", "Evaluation", "Genome", "Problem", "Segment", "Selection"]
