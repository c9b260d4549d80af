"""What every criterion must do."""

from __future__ import annotations

from itertools import product

import numpy as np

from termsel.data.features import BoolArray, FloatArray, Points
from termsel.fitting.population import Fits
from termsel.models.polynomial import Polynomial3D
from termsel.models.terms import Term
from termsel.selection.criteria import Criterion
from termsel.selection.problems.base import ProblemData
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.proofs.proof import prove
from termsel.testing.cases import (
    Case,
    Suite,
    declaration_check,
    label_with_options,
    make_instance,
    require,
    require_unchanged,
    through_pickle,
)
from termsel.testing.scenes import imaged_features, seeded_generator

PIXELS = 1000.0
NOISE_PX = 0.5
"""Standard deviation of the measurements [px]."""

SETS = 4
"""Random sets of points on which all selections are compared."""


class _Recorder(Criterion):
    """Records the input of a criterion."""

    name = "recorder"

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Fits] = []

    def score(self, fits: Fits) -> FloatArray:
        self.seen.append(fits)
        return np.zeros(len(fits.terms))


def score_shape(criterion: Criterion) -> None:
    """It gives one figure for each fitted model."""
    # Searches evaluate whole populations, and a fit alone is a population of one.
    for masks in (_term_masks(), _term_masks()[:1]):
        score = criterion.score(_noisy_fits(masks))
        require(isinstance(score, np.ndarray) and score.shape == (len(masks),)
                and np.issubdtype(score.dtype, np.floating),
                f"score() of {len(masks)} fits must be an array of {len(masks)} figures, not "
                f"{getattr(score, 'dtype', type(score).__name__)} of shape {np.shape(score)}")


def score_finite(criterion: Criterion) -> None:
    """Its figures are finite for models that are determined and have finite errors."""
    score = criterion.score(_noisy_fits(_term_masks()))
    require(np.isfinite(score).all(), f"score() must be finite for finite errors, not {score}")


def smaller_is_better(criterion: Criterion) -> None:
    """The better a model fits, the smaller the figure."""
    score = criterion.score(_noisy_fits(_term_masks()))
    # Every further term that lacks makes the fit worse, far beyond the noise.
    require((np.diff(score) > 0).all(),
            "models that lack no term, then one, two and more of the terms the measurements were "
            f"made with, must be given ever larger figures, not {score}")


def deterministic(criterion: Criterion) -> None:
    """The same fits get the same figures, here and in another process."""
    fits = _noisy_fits(_term_masks())
    first = criterion.score(fits)
    # An equal object, and one that has been in another process.
    repeated = (criterion.score(fits), type(criterion)(**criterion.options).score(fits),
                through_pickle(criterion).score(_noisy_fits(_term_masks())))
    require(all(np.array_equal(first, score) for score in repeated),
            "score() of the same fits differs from one call or object to the next")


def one_by_one(criterion: Criterion) -> None:
    """A model's figure does not depend on the models scored with it."""
    masks = _term_masks()
    joint = criterion.score(_noisy_fits(masks))
    single = np.concatenate([criterion.score(_noisy_fits(masks[i:i + 1]))
                             for i in range(len(masks))])
    require(np.allclose(joint, single),
            f"scored together the models get {joint}, one by one {single}; a search keeps "
            "figures and compares them later")
# Summation in another order may differ by rounding.


def inputs_unchanged(criterion: Criterion) -> None:
    """It does not change its inputs."""
    fits = _noisy_fits(_term_masks())
    arrays = {**vars(fits), "check_errors": fits.check_errors}
    require_unchanged({f"fits.{name}": value for name, value in arrays.items()
                       if isinstance(value, np.ndarray)}, "score()", lambda: criterion.score(fits))


def subset_score_agrees(criterion: Criterion) -> None:
    """The optimum by its subset score, if it declares one, is that of its figures."""
    if not criterion.subset_score:
        return
    for seed in range(SETS):
        problem = SelectionProblem(_random_inputs(criterion, seed), terms=True, features=False)
        # All 2^8 selections of 4 terms for each axis, so that the optimum needs no search.
        genes = np.array(list(product((False, True), repeat=problem.genome.size)))
        evaluation = problem.evaluate(genes)
        feasible = evaluation.violation == 0
        # Its proof goes by bounds on subset_score, and must end at the optimum by score().
        *_, proof = prove(problem)
        proven = problem.evaluate(np.array(proof.front()[-1:]))
        smallest = evaluation.objectives[feasible, 0].min()
        require(bool(np.isclose(proven.objectives[0, 0], smallest, rtol=1e-9)),
                f"the best selection by subset_score {criterion.subset_score!r} and subset_cost() "
                f"has the score {proven.objectives[0, 0]:.9g}; another one has {smallest:.9g}")


def cases(criterion: type[Criterion] | Criterion) -> list[Case]:
    """Return a criterion, with its default options if it is a class."""
    criterion_object = make_instance(criterion)
    return [Case(label_with_options(criterion_object, criterion_object.options),
                 lambda: criterion_object)]


SUITE = Suite((declaration_check("criteria"), score_shape, score_finite, smaller_is_better,
               deterministic,
               one_by_one, inputs_unchanged, subset_score_agrees), cases)


def _model_of_terms() -> Polynomial3D:
    """Return the model whose terms the masks are of."""
    return Polynomial3D(degree=2)


def _term_masks() -> BoolArray:
    """Return term masks, shape (4, 20), from the true model to ones that lack ever more."""
    names = _model_of_terms().terms
    lacking: tuple[tuple[str, ...], ...] = ((), ("Z",), ("Z", "Y"), ("Z", "Y", "X"))
    masks = []
    for missing in lacking:
        columns = {"1", "X", "Y", "Z"} - set(missing)
        masks.append([Term.parse(name).column in columns for name in names])
    return np.array(masks)


def _noisy_fits(masks: BoolArray) -> Fits:
    """Return least-squares fits of an affine scene with noise, one for each term mask, (p, k).

    A problem makes them as it does in a search, and a criterion that records them gets them out.
    """
    model = _model_of_terms()
    rng = seeded_generator()
    affine = {"1": 0.1, "X": 0.5, "Y": 0.4, "Z": 0.2}
    # The other terms have no part in the measurements.
    truth = np.array([affine.get(Term.parse(name).column, 0.0) for name in model.terms])
    # Control and selection points of one scene, with independent noise.
    control, check = (imaged_features(model, truth, rng, points=40) for _ in range(2))
    noise = NOISE_PX / PIXELS
    noisy = [Points(features.points.ids,
                    features.points.image + rng.normal(0.0, noise, (40, 2)),
                    features.points.ground) for features in (control, check)]
    recorder = _Recorder()
    inputs = ProblemData(model, control.with_(points=noisy[0]), noisy[1], PIXELS, recorder)
    SelectionProblem(inputs, terms=True, features=False).evaluate(masks)
    return recorder.seen[-1]


def _random_inputs(criterion: Criterion, seed: int) -> ProblemData:
    """Return the inputs of a problem of few points, which an affine model explains but for noise.

    The noise is large against the terms, so that the best selections differ from seed to seed.
    """
    model = Polynomial3D(degree=1)
    rng = np.random.default_rng(seed)
    control, check = (imaged_features(model, rng.normal(0.0, 0.5, len(model.terms)), rng, points=n)
                      for n in (12, 8))
    noisy = [Points(f.points.ids, f.points.image + rng.normal(0.0, 0.2, f.points.image.shape),
                    f.points.ground) for f in (control, check)]
    return ProblemData(model, control.with_(points=noisy[0]), noisy[1], PIXELS, criterion)
