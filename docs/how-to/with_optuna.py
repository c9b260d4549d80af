"""Terms selected by the tree-structured Parzen estimator of optuna."""

import optuna

import termsel
from termsel_optimisers import from_ask_tell

optuna.logging.set_verbosity(optuna.logging.WARNING)


class Parzen:
    """The tree-structured Parzen estimator of optuna."""

    def __init__(self, problem, rng):
        self.labels = problem.genome.labels
        sampler = optuna.samplers.TPESampler(seed=int(rng.integers(2**32)))
        self.study = optuna.create_study(sampler=sampler)

    def ask(self):
        self.trial = self.study.ask()
        return [self.trial.suggest_categorical(label, [False, True]) for label in self.labels]

    def tell(self, genes, evaluation):
        cost = evaluation.objectives[0, 0] + 1e6 * evaluation.violation[0]
        self.study.tell(self.trial, cost)


if __name__ == "__main__":
    result = termsel.run("poly-terms", solver=from_ask_tell(Parzen), evaluations=100,
                         options={"degree": 2})
    print(f"{result.solver}: {len(result.selection.terms)} terms, "
          f"{result.rmse['independent'].total:.2f} px at independent points")
