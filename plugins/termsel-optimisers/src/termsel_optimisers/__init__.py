"""Algorithms of DEAP and pymoo as solvers, and problems for scripts of theirs, as a plugin.

References
----------
Fortin, De Rainville, Gardner, Parizeau and Gagné 2012, DEAP: Evolutionary algorithms made easy,
J. Mach. Learn. Res. 13. Blank and Deb 2020, pymoo: Multi-objective optimization in Python, IEEE
Access 8.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    from termsel import Solver
    from termsel_optimisers.ask_tell import from_ask_tell
    from termsel_optimisers.deap_algorithms import from_deap
    from termsel_optimisers.deap_toolbox import to_deap
    from termsel_optimisers.pymoo_algorithms import from_pymoo

# What is not needed for `termsel list` is not imported for it: DEAP and pymoo take a second.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "ask_tell": ["from_ask_tell"], "deap_algorithms": ["from_deap"],
    "deap_toolbox": ["to_deap"], "pymoo_algorithms": ["from_pymoo"]})

__all__ = ["from_ask_tell", "from_deap", "from_pymoo", "to_deap"]


@hookimpl
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return the solvers."""
    from termsel_optimisers.deap_algorithms import Deap
    from termsel_optimisers.pymoo_algorithms import Pymoo
    from termsel_optimisers.survivals import AgeMoea2, SmsEmoa, Spea2

    return [Deap, Pymoo, AgeMoea2, SmsEmoa, Spea2]
