"""Search: solvers know genes and objectives, and no geometry."""

from termsel.solvers.base import Generation, Solver

__all__ = ["Generation", "Solver"]
