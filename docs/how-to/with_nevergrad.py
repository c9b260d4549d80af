"""Terms selected by an optimiser of nevergrad."""

import nevergrad

import termsel
from termsel_optimisers import from_ask_tell

BATCH = 10


class OnePlusOne:
    """The discrete (1 + 1) evolution strategy of nevergrad."""

    def __init__(self, problem, rng):
        space = nevergrad.p.Tuple(*[nevergrad.p.Choice([False, True])
                                    for _ in range(problem.genome.size)])
        space.random_state.seed(int(rng.integers(2**32)))
        self.optimizer = nevergrad.optimizers.DiscreteOnePlusOne(space, budget=1000,
                                                                 num_workers=BATCH)

    def ask(self):
        self.candidates = [self.optimizer.ask() for _ in range(BATCH)]
        return [candidate.value for candidate in self.candidates]

    def tell(self, genes, evaluation):
        costs = evaluation.objectives[:, 0] + 1e6 * evaluation.violation
        for candidate, cost in zip(self.candidates, costs, strict=True):
            self.optimizer.tell(candidate, cost)


if __name__ == "__main__":
    result = termsel.run("poly-terms", solver=from_ask_tell(OnePlusOne), evaluations=1000,
                         options={"degree": 2})
    print(f"{result.solver}: {len(result.selection.terms)} terms, "
          f"{result.rmse['independent'].total:.2f} px at independent points")
