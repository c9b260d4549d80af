"""Candidates: models that need no search, each with its title and the verb `fit`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.candidates.local import Interpolated
from termsel.candidates.ridge import RidgeByOrder
from termsel.candidates.robust import Reweighted
from termsel.candidates.selected import ForwardSelection
from termsel.candidates.shrunken import Averaging
from termsel.errors import TermselError
from termsel.fits.fit import Estimator, Fit
from termsel.fits.least_squares import LEAST_SQUARES
from termsel.fits.of_features import control_of, require_determined
from termsel.measurements.features import FeatureSet
from termsel.measurements.scaling import Scaling, scaling_of
from termsel.models.base import SensorModel
from termsel.models.helmert import Helmert2D
from termsel.models.interpolating import Field, Field3D, ThinPlate
from termsel.models.polynomial import Affine, Polynomial2D, Polynomial3D
from termsel.models.projective import DLT3D, Projective2D
from termsel.models.rational import RationalFunctions
from termsel.threads import one_blas_thread

Kind = Literal["contained", "plain", "full", "ridge", "selected", "shrunken", "local", "few",
               "robust"]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model that needs no search.

    Parameters
    ----------
    name : str
    title : str
        In words, with its article.
    kind : str
        "contained" for a limit of the shrunken polynomials, which find it where the points call
        for it, "plain" for another structure that takes neither selection nor shrinkage, "full"
        for the full RFM, "few" for what serves where points are too few to shrink; else how its
        terms or coefficients are found. "robust" ones give features that fit badly less weight, and
        are no candidates for the choice.
    with_heights, without : SensorModel or None
        The model for features with heights that differ, and for others; None if there is none.
    estimator : Estimator
    short : str
        Title in tables; the name by default.
    """

    name: str
    title: str
    kind: Kind
    with_heights: SensorModel | None
    without: SensorModel | None
    estimator: Estimator = LEAST_SQUARES
    short: str = ""

    @property
    def is_plain(self) -> bool:
        """True if it takes neither selection nor shrinkage, and is plainer than the full RFM."""
        return self.kind in ("contained", "plain", "few")

    @property
    def label(self) -> str:
        """What tables and short sentences call it."""
        return self.short or self.name

    def model(self, heights: bool) -> SensorModel | None:
        """Return the model for features with heights, or without."""
        return self.with_heights if heights else self.without

    @one_blas_thread
    def fit(self, features: FeatureSet) -> Fit:
        """Fit the candidate to control features.

        Parameters
        ----------
        features : FeatureSet
            Lines, and points with the role control or none, are control. Points with the role
            check, independent or off are left out.

        Raises
        ------
        TermselError
            If there is no control, the control does not determine the candidate, or the candidate
            has no model for features with or without heights.
        """
        control = control_of(features)
        heights = heights_differ(control)
        if self.model(heights) is None:
            raise TermselError(
                f"{self.title} needs heights that are known and differ" if self.without is None
                else f"{self.title} is for features without heights",
                hint="Choose another model, such as shrunken-cubic.")
        return self.fit_control(control, heights, scaling_of(control))

    def fit_control(self, control: FeatureSet, heights: bool, scaling: Scaling) -> Fit:
        """Fit the candidate to features, whatever the roles of points.

        Parameters
        ----------
        control : FeatureSet
        heights : bool
            Whether heights are known and differ.
        scaling : Scaling

        Raises
        ------
        Undetermined
            If the features do not determine the candidate.
        """
        model = self.model(heights)
        assert model is not None
        terms, used = (np.ones(n, dtype=bool) for n in (len(model.terms), len(control)))
        return require_determined(self.estimator.fit(model, control, scaling, terms, used))


CANDIDATES = (
    Candidate("similarity", "a plane similarity", "few", Helmert2D(), Helmert2D()),
    Candidate("mirrored-similarity", "a mirrored plane similarity", "few",
              Helmert2D(mirrored=True), Helmert2D(mirrored=True), short="mirrored similarity"),
    Candidate("plane-affine", "an affine polynomial without heights", "few",
              Polynomial2D(degree=1), None, short="plane affine"),
    Candidate("affine", "an affine polynomial", "contained", Affine(), Polynomial2D(degree=1)),
    Candidate("dlt", "a DLT", "plain", DLT3D(), None, short="DLT"),
    Candidate("projective", "a projective transformation", "plain", None, Projective2D()),
    Candidate("quadratic", "a quadratic polynomial", "contained", Polynomial3D(degree=2),
              Polynomial2D(degree=2)),
    Candidate("cubic", "a cubic polynomial", "contained", Polynomial3D(degree=3),
              Polynomial2D(degree=3)),
    Candidate("rfm-2", "a second-order RFM", "plain", RationalFunctions(order=2), None,
              short="second-order RFM"),
    Candidate("rfm-3", "a third-order RFM", "full", RationalFunctions(), None, short="full RFM"),
    Candidate("ridge", "a third-order RFM by ridge regression", "ridge", RationalFunctions(),
              None, RidgeByOrder(), "full RFM, ridge"),
    Candidate("selected", "a cubic polynomial of selected terms", "selected",
              Polynomial3D(degree=3), Polynomial2D(degree=3), ForwardSelection(),
              "selected cubic"),
    Candidate("shrunken-quadratic", "a shrunken quadratic polynomial", "shrunken",
              Polynomial3D(degree=2), Polynomial2D(degree=2), Averaging(), "shrunken quadratic"),
    Candidate("shrunken-cubic", "a shrunken cubic polynomial", "shrunken",
              Polynomial3D(degree=3), Polynomial2D(degree=3), Averaging(), "shrunken cubic"),
    Candidate("field", "a shrunken cubic polynomial with a random field", "local", Field3D(),
              Field(), Interpolated(), "random field"),
    Candidate("tps", "a thin-plate spline", "local", None, ThinPlate(), Interpolated(),
              "thin-plate spline"),
    Candidate("huber", "a quadratic polynomial by Huber's estimator", "robust",
              Polynomial3D(degree=2), Polynomial2D(degree=2), Reweighted(biweight=False),
              "quadratic, Huber"),
    Candidate("tukey", "a quadratic polynomial by Tukey's biweight", "robust",
              Polynomial3D(degree=2), Polynomial2D(degree=2), Reweighted(biweight=True),
              "quadratic, Tukey"),
)
"""All candidates, in the order of the tables that compare them."""


def named(name: str) -> Candidate | None:
    """Return the candidate of a name, or None."""
    return next((one for one in CANDIDATES if one.name == name), None)


def heights_differ(features: FeatureSet) -> bool:
    """Return whether all features have heights, and they are not those of a plane."""
    if features.without_height():
        return False
    scaled = scaling_of(features).ground(features.ground_vertices())
    plane = np.column_stack([np.ones(len(scaled)), scaled[:, :2]])
    rest = scaled[:, 2] - plane @ np.linalg.lstsq(plane, scaled[:, 2])[0]
    return bool(np.abs(rest).max() > TOLERANCE)
