"""Search: solvers know genes and objectives, and no geometry."""

from termsel.selection.solvers.base import Generation, Solver

__all__ = ["Generation", "Solver"]
