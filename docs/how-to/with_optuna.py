"""Terms selected by the tree-structured Parzen estimator of optuna."""

import optuna

import termsel
from termsel_optimisers import from_ask_tell

optuna.logging.set_verbosity(optuna.logging.WARNING)

BATCH = 10


class Parzen:
    """The tree-structured Parzen estimator of optuna."""

    def __init__(self, problem, rng):
        self.labels = problem.genome.labels
        sampler = optuna.samplers.TPESampler(seed=int(rng.integers(2**32)), constant_liar=True)
        self.study = optuna.create_study(sampler=sampler)

    def ask(self):
        self.trials = [self.study.ask() for _ in range(BATCH)]
        return [[trial.suggest_categorical(label, [False, True]) for label in self.labels]
                for trial in self.trials]

    def tell(self, genes, evaluation):
        costs = evaluation.objectives[:, 0] + 1e6 * evaluation.violation
        for trial, cost in zip(self.trials, costs, strict=True):
            self.study.tell(trial, cost)


if __name__ == "__main__":
    result = termsel.run("poly-terms", solver=from_ask_tell(Parzen), evaluations=100,
                         options={"degree": 2})
    print(f"{result.solver}: {len(result.selection.terms)} terms, "
          f"{result.rmse['independent'].total:.2f} px at independent points")
