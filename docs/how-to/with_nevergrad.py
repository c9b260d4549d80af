"""Terms selected by an optimiser of nevergrad."""

import nevergrad

import termsel
from termsel_optimisers import from_ask_tell


class OnePlusOne:
    """The discrete (1 + 1) evolution strategy of nevergrad."""

    def __init__(self, problem, rng):
        space = nevergrad.p.Tuple(*[nevergrad.p.Choice([False, True])
                                    for _ in range(problem.genome.size)])
        space.random_state.seed(int(rng.integers(2**32)))
        self.optimizer = nevergrad.optimizers.DiscreteOnePlusOne(space, budget=1000)

    def ask(self):
        self.candidate = self.optimizer.ask()
        return self.candidate.value

    def tell(self, genes, evaluation):
        cost = evaluation.objectives[0, 0] + 1e6 * evaluation.violation[0]
        self.optimizer.tell(self.candidate, cost)


if __name__ == "__main__":
    result = termsel.run("poly-terms", solver=from_ask_tell(OnePlusOne), evaluations=1000,
                         options={"degree": 2})
    print(f"{result.solver}: {len(result.selection.terms)} terms, "
          f"{result.rmse['independent'].total:.2f} px at independent points")
