"""What every sensor model must do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from termsel.data.features import FeatureSet, FloatArray
from termsel.data.scaling import Scaling
from termsel.models.base import SensorModel
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import ProblemData
from termsel.selection.problems.selection import SelectionProblem
from termsel.testing.cases import (
    Case,
    Suite,
    declaration_check,
    label_with_options,
    require,
    require_unchanged,
    through_pickle,
)
from termsel.testing.model_equations import (
    control_kinds,
    equations,
    exact_recovery,
    fit,
    linearisation,
    recovery_from_lines,
    translation,
)
from termsel.testing.scenes import (
    accepted_scenes,
    flatten_heights,
    imaged_features,
    random_coefficients,
    random_ground,
    seeded_generator,
)

PLACE = Scaling((48.5, 34.8, 1850.0), (0.05, 0.04, 150.0), (3500.0, 4000.0), 4000.0), "EPSG:4979"
"""Scaling and CRS that models are prepared for."""


def term_names(model: SensorModel) -> None:
    """Its terms have different names, which never change."""
    terms = model.terms
    require(isinstance(terms, tuple) and terms and all(isinstance(t, str) and t for t in terms),
            f"terms must be a tuple of names, not {terms!r}")
    twice = sorted({name for name in terms if terms.count(name) > 1})
    require(not twice, f"terms must have different names; several are called {', '.join(twice)}")
    model.equations(accepted_scenes(model)[-1])
    # A stored result names its terms, which an equal model must understand.
    twin = _equal_model(model)
    require(model.terms == terms and twin.terms == terms,
            "terms must be the same names in the same order whenever they are asked for; results "
            "name them")


def axis(model: SensorModel) -> None:
    """It declares for each term whether it acts on the line (0), the sample (1) or both (2)."""
    codes = np.asarray(model.axis)
    k = len(model.terms)
    require(codes.shape == (k,),
            f"axis must have shape ({k},), one code per term, not {codes.shape}")
    require(np.issubdtype(codes.dtype, np.integer) and np.isin(codes, (0, 1, 2)).all(),
            f"axis must hold the integers 0 (line), 1 (sample) and 2 (both), not {codes}")
    # Random, so that no coefficient is zero by chance.
    coefficients = random_coefficients(model, seeded_generator())
    ground = random_ground(seeded_generator(), 40)
    image = model.project(coefficients, ground)
    for term, code in enumerate(codes):
        # A term without which an axis changes acts on that axis.
        without = coefficients.copy()
        without[term] = 0.0
        moved = np.abs(model.project(without, ground) - image).max(axis=0) > 0
        for code_of_axis, name in ((0, "line"), (1, "sample")):
            require(code in (code_of_axis, 2) or not moved[code_of_axis],
                    f"axis says that term {model.terms[term]!r} does not act on the {name}, but "
                    f"project() gives other {name}s without it")


def inputs_unchanged(model: SensorModel) -> None:
    """It does not change its inputs."""
    coefficients = random_coefficients(model, seeded_generator())
    ground = random_ground(seeded_generator(), 9)
    features = accepted_scenes(model)[-1]
    arrays = {"the coefficients": coefficients, "the ground points": ground, **{
        f"{name} of the features": array for name, array in (
            ("image points", features.points.image), ("ground points", features.points.ground),
            ("image lines", features.lines.image), ("ground lines", features.lines.ground))}}
    require_unchanged(arrays, "it", lambda: (
        model.equations(features), model.start(features), model.project(coefficients, ground),
        model.denominators(coefficients, ground), model.residual_weights(ground, ground[:4])))


def project_shapes(model: SensorModel) -> None:
    """It projects any number of points, none included, for one set of coefficients or many."""
    k = len(model.terms)
    coefficients = random_coefficients(model, seeded_generator())
    # No points at all, and no sets at all, occur at the ends of searches.
    for n, batch in product((0, 1, 7), ((), (1,), (5,), (2, 3))):
        image = model.project(np.broadcast_to(coefficients, (*batch, k)).copy(),
                              random_ground(seeded_generator(), n))
        require(np.shape(image) == (*batch, n, 2),
                f"project() of coefficients of shape {(*batch, k)} and {n} ground points must have "
                f"shape {(*batch, n, 2)}, not {np.shape(image)}")


def batch_project(model: SensorModel) -> None:
    """Many sets of coefficients at once give the same as one by one."""
    rng = seeded_generator()
    # Two axes before the coefficients, as searches of several populations have them.
    sets = np.stack([random_coefficients(model, rng) for _ in range(6)]).reshape(2, 3, -1)
    ground = random_ground(rng, 11)
    control = accepted_scenes(model)[-1]

    def predict(coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        return model.predict(coefficients, control, ground)

    for name, method in (("project", model.project), ("denominators", model.denominators),
                         ("predict", predict)):
        joint = method(sets, ground)
        if joint is None:  # a model without denominators
            continue
        require(np.shape(joint) == (2, 3, 11, 2), f"{name}() of coefficients of shape "
                f"{sets.shape} and 11 ground points must have shape (2, 3, 11, 2), not "
                f"{np.shape(joint)}")
        for index in np.ndindex(2, 3):
            single = method(sets[index], ground)
            require(single is not None and np.allclose(joint[index], single, rtol=0, atol=1e-9),
                    f"{name}() gives other values for a set of coefficients alone than among "
                    "others")


def deterministic(model: SensorModel) -> None:
    """The same inputs give the same results, from this object and from an equal one."""
    features = accepted_scenes(model)[-1]
    ground = random_ground(seeded_generator(), 50)
    coefficients = random_coefficients(model, seeded_generator())
    first = model.equations(features)
    image = model.project(coefficients, ground)
    # Nothing may be kept in the object between calls.
    for same_model in (model, _equal_model(model)):
        repeated = same_model.equations(features)
        require(np.array_equal(first.A, repeated.A) and np.array_equal(first.b, repeated.b),
                "equations() of the same features differ from one call to the next")
        require(np.array_equal(same_model.project(coefficients, ground), image),
                "project() of the same points differs from one call to the next")


def prepared(model: SensorModel) -> None:
    """Prepared for features, it has their scaling and CRS, and is otherwise unchanged."""
    before = model.scaling, model.crs
    assert model.scaling is not None
    # Another image scale alone: all else must stay.
    scaling = replace(model.scaling, image_scale=2 * model.scaling.image_scale)
    ready = model.prepared(scaling, model.crs)
    require((ready.scaling, ready.crs) == (scaling, model.crs),
            "prepared() must return a model with the scaling and crs it is given; begin with "
            "super().prepared(scaling, crs)")
    require((ready.options, ready.terms) == (model.options, model.terms),
            "prepared() gives a model with other options or terms")
    require((model.scaling, model.crs) == before,
            "prepared() changes the model itself; change a copy, as super().prepared() does")


def picklable(model: SensorModel) -> None:
    """It works in another process."""
    coefficients = random_coefficients(model, seeded_generator())
    ground = random_ground(seeded_generator(), 9)
    copy = through_pickle(model)
    require(
        copy.terms == model.terms
        and np.array_equal(copy.project(coefficients, ground), model.project(coefficients, ground)),
        "the copy that another process gets projects otherwise",
    )


def masks_stay_finite(model: SensorModel) -> None:
    """No selection of terms or features, however poor, breaks an evaluation."""
    for features in accepted_scenes(model):
        for kind, problem in _problems_with_model(model, features):
            size = problem.genome.size
            # None, each alone, and all.
            genes = np.concatenate([np.zeros((1, size)), np.eye(size), np.ones((1, size))]) > 0
            evaluation = problem.evaluate(genes)
            require(np.isfinite(evaluation.objectives).all()
                    and np.isfinite(evaluation.violation).all(),
                    f"choosing none, one or all of the {kind} gives an evaluation that is not "
                    "finite")


def height(model: SensorModel) -> None:
    """`uses_height` shows correctly whether heights matter."""
    features = accepted_scenes(model)[-1]
    ground = random_ground(seeded_generator(), 50)
    coefficients = random_coefficients(model, seeded_generator())
    flat = features.with_(points=replace(features.points,
                                         ground=flatten_heights(features.points.ground)),
                          lines=replace(features.lines,
                                        ground=flatten_heights(features.lines.ground)))
    first = model.equations(features)
    second = model.equations(flat)
    # Positions show whether heights act on the image, equations whether they act on the fit.
    same_image = np.array_equal(model.predict(coefficients, features, ground),
                                model.predict(coefficients, flat, flatten_heights(ground)))
    same_model = (same_image and np.array_equal(first.A, second.A)
                  and np.array_equal(first.b, second.b))
    if model.uses_height:
        # Weights of lines may depend on heights under any model.
        require(not same_image, "uses_height is True, but heights make no difference; declare "
                "uses_height = False, so that it takes features without height")
    else:
        require(same_model, "uses_height is False, but other heights give other equations or other "
                "image positions")


def residual_weights(model: SensorModel) -> None:
    """Weights that spread residuals, if any, have a row per place and are finite."""
    rng = seeded_generator()
    control = random_ground(rng, 8)
    for m in (0, 1, 5):
        weights = model.residual_weights(control, random_ground(rng, m))
        if weights is not None:
            require(np.shape(weights) == (m, 8), "residual_weights() of 8 control points and "
                    f"{m} places must have shape ({m}, 8), not {np.shape(weights)}")
            require(np.isfinite(weights).all(), "residual_weights() must be finite")


def cases(model: type[SensorModel] | SensorModel, *,
          options: Iterable[Mapping[str, Any]] | None = None,
          place: tuple[Scaling, str] = PLACE) -> list[Case]:
    """Return a case for each set of options of a model, which is prepared for a place.

    The sets are those of `options`, else that of the model if it is an object. A class is checked
    with its default options, and with every other choice of each option that has choices.
    """
    cls = model if isinstance(model, type) else type(model)
    option_sets: Iterable[Mapping[str, Any]]
    if options is not None:
        option_sets = options
    else:
        option_sets = _option_choices(cls) if isinstance(model, type) else [model.options]
    return [Case(label_with_options(cls, option_set), partial(_make_model, cls, option_set, place))
            for option_set in option_sets]


SUITE = Suite((
    declaration_check("models", type), term_names, axis, control_kinds, equations, inputs_unchanged,
    linearisation, exact_recovery, recovery_from_lines, fit, translation, project_shapes,
    batch_project, deterministic, prepared, picklable, masks_stay_finite, height,
    residual_weights), cases)


def _make_model(model: type[SensorModel], options: Mapping[str, Any],
                place: tuple[Scaling, str]) -> SensorModel:
    """Return a model with options, prepared with the scaling and CRS of a place."""
    return model(**options).prepared(*place)


def _equal_model(model: SensorModel) -> SensorModel:
    """Return another model with the same options, prepared for the same features."""
    assert model.scaling is not None
    return _make_model(type(model), model.options, (model.scaling, model.crs))


def _option_choices(model: type[SensorModel]) -> list[dict[str, Any]]:
    """Return sets of options: none, then each choice other than a default by itself."""
    option_sets: list[dict[str, Any]] = [{}]
    for option in model.declared_options:
        # Options with few values; numbers have no natural second value.
        choices = (True, False) if option.type is bool else map(option.parse, option.choices)
        option_sets += [{option.name: choice} for choice in choices if choice != option.default]
    return option_sets


def _problems_with_model(model: SensorModel,
                         features: FeatureSet) -> list[tuple[str, SelectionProblem]]:
    """Return selections of terms and of features with a model, by title."""
    truth = random_coefficients(model, seeded_generator())
    # Selection points by the same model, at other places.
    check = imaged_features(model, truth, np.random.default_rng(2), points=10).points
    inputs = ProblemData(model, features, check, 1000.0, CheckRmse())
    return [("terms", SelectionProblem(inputs, terms=True, features=False)),
            ("terms, line and sample together",
             SelectionProblem(inputs, terms=True, features=False, mask="shared")),
            ("features", SelectionProblem(inputs, terms=False, features=True))]
