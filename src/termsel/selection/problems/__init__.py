"""Problems: genes to objectives."""

from termsel.selection.problems.base import Evaluation, Problem, Selection
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits, Segment

__all__ = ["Bits", "Evaluation", "Genome", "Problem", "Segment", "Selection"]
