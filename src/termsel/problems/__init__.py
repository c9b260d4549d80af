"""Problems: genes to objectives."""

from termsel.problems.base import Evaluation, Genome, Problem, Segment, Selection

__all__ = ["Evaluation", "Genome", "Problem", "Segment", "Selection"]
