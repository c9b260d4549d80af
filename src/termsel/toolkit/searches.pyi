from termsel.selection.best_subsets.features.walk import RowSystem as RowSystem
from termsel.selection.problems.base import WORST as WORST
from termsel.selection.problems.objectives import unit_deviations as unit_deviations
from termsel.selection.problems.recipes import CAP as CAP
from termsel.selection.problems.recipes import OBJECTIVES as OBJECTIVES
from termsel.selection.problems.recipes import OF_BOTH as OF_BOTH
from termsel.selection.problems.recipes import OF_TERMS as OF_TERMS
from termsel.selection.problems.recipes import RECOMMEND as RECOMMEND
from termsel.selection.problems.recipes import YAVARI as YAVARI
from termsel.selection.problems.recipes import select_both as select_both
from termsel.selection.problems.recipes import select_terms as select_terms
from termsel.selection.problems.recipes import with_defaults as with_defaults
from termsel.selection.problems.segments import SEGMENTS as SEGMENTS
from termsel.selection.problems.segments import AnySegment as AnySegment
from termsel.selection.problems.segments import Genes as Genes
from termsel.selection.solvers.bridges.chance import OwnChance as OwnChance
from termsel.selection.solvers.bridges.pareto import OPTIONS as OPTIONS
from termsel.selection.solvers.bridges.pareto import Nsga2 as Nsga2
from termsel.selection.solvers.bridges.pareto import population_size as population_size
from termsel.selection.solvers.bridges.pymoo_operators import common_operators as common_operators
from termsel.selection.solvers.bridges.pymoo_problem import step_algorithm as step_algorithm
from termsel.selection.solvers.genetic.operators import cross_pairs as cross_pairs
from termsel.selection.solvers.genetic.operators import mutate_genes as mutate_genes
from termsel.selection.solvers.ledger import Ledger as Ledger
from termsel.selection.solvers.observers import Observer as Observer
from termsel.selection.solvers.proofs.exact import gap_to_optimum as gap_to_optimum
from termsel.selection.solvers.proofs.proof import TIE as TIE
from termsel.selection.solvers.regression.base import (
    regressions_of_problem as regressions_of_problem,
)
