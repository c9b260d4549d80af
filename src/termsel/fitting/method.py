"""The one interface of all that turns control into a fitted model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from termsel.data.features import BoolArray, FloatArray
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Estimator, Fit, HeldOut
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.models.base import SensorModel


@dataclass(frozen=True, eq=False)
class Suspects:
    """Features against what the other features predict of them, points before lines.

    Parameters
    ----------
    blunders : ndarray of bool, shape (n,)
    probable : ndarray of bool, shape (n,)
        Those blunders that the features in use do not show for certain.
    undecided : ndarray of bool, shape (n,)
        Features with as large an error, at whose place the other features do not determine the
        model.
    errors : ndarray, shape (n,)
        Largest error in line or sample, or of a vertex off its line, as the features in use predict
        it [px].
    limits : ndarray, shape (n,)
        Error that would be named at each feature [px].

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> blunders = np.array([False, True])
    >>> none = np.array([False, False])
    >>> suspects = termsel.Suspects(blunders, probable=none, undecided=none,
    ...                             errors=np.array([0.4, 30.0]), limits=np.array([2.0, 2.0]))
    >>> suspects.errors[suspects.blunders]
    array([30.])
    """

    blunders: BoolArray
    probable: BoolArray
    undecided: BoolArray
    errors: FloatArray
    limits: FloatArray

    def __post_init__(self) -> None:
        for array in (self.blunders, self.probable, self.undecided, self.errors, self.limits):
            array.setflags(write=False)  # who asks again gets the same


@dataclass(frozen=True, eq=False)
class Method(ABC):
    """Whatever turns control into a fitted model: one interface for all that termsel does.

    A method has a name and `fit`; the errors that it makes at features held out are its
    estimator's, or its own (`held_out`). One object is fitted to many parts of the same features,
    so it keeps nothing of them. The other attributes say what place it has among the methods that
    the method "auto" chooses from.

    Parameters
    ----------
    name : str
        As in `termsel.fit` and ``termsel describe``.
    title : str
        In words, with its article, such as "a cubic polynomial".
    short : str
        Title in tables; by default the name.
    estimator : Estimator
        How its coefficients are found; with it a stored result is the same fit again.
    is_plain : bool
        Whether it takes neither selection nor shrinkage, and is plainer than a full RFM.
    has_prior : bool
        Whether a prior of its own holds what the features do not determine. Then it is chosen where
        it is better by one standard error; else it must be better by three, and have the smaller
        RMSE.
    contains : tuple of str
        Names of methods that it has as limits. They are not chosen next to it. Where it has a
        prior, it takes the place of those among them that have one, as soon as it is supported.
    family : str
        Plural that names it together with others that have the same limits.
    needs : tuple of str
        Names of methods without which it is not supported.
    for_few : bool
        Whether it is for features that are too few for any method with a prior.
    only_shown : bool
        Whether it is shown for comparison and never chosen.
    on_request : bool
        Whether auto leaves it alone, so that it is fitted only where it is asked for.
    central : bool
        Whether it is a central projection, as whole images may be: two standard errors are then
        enough for it in place of three.
    judges_blunders : bool
        Whether blunders are judged by it where it is chosen, as by a central projection: by what
        it leaves of each point, and how well the others predict it.
    from_one : bool
        Whether one feature is enough, as the method knows what features do not determine. Then
        two or three are not taken for a model that they determine exactly.
    max_features : float
        Number of features up to which auto tries it: more show as much as what it knows. Where the
        choice is repeated without some features, the number of all of them counts. A method that
        is asked for by its name is fitted to more.

    Examples
    --------
    >>> import termsel
    >>> class Plane(termsel.Method):
    ...     "An affine polynomial, whatever the features."
    ...
    ...     def fit(self, data):
    ...         return termsel.fit(data.features, "affine")
    >>> Plane("plane", "an affine polynomial").title
    'an affine polynomial'
    """

    kind: ClassVar[str] = "method"
    """Word for it in messages."""
    name: str
    title: str
    _: KW_ONLY
    short: str = ""
    estimator: Estimator = LEAST_SQUARES
    is_plain: bool = False
    has_prior: bool = False
    contains: tuple[str, ...] = ()
    family: str = ""
    needs: tuple[str, ...] = ()
    for_few: bool = False
    only_shown: bool = False
    on_request: bool = False
    central: bool = False
    judges_blunders: bool = False
    from_one: bool = False
    max_features: float = np.inf

    @property
    def label(self) -> str:
        """The short name that tables and short sentences show."""
        return self.short or self.name

    @property
    def summary(self) -> str:
        """The sentence that lists of methods show."""
        return f"{self.title[:1].upper()}{self.title[1:]}."

    @abstractmethod
    def fit(self, data: FitData) -> Fit:
        """Fit the method to features, whatever the roles of points.

        Parameters
        ----------
        data : FitData
            The features with their scaling. All that is known of the image is in its features:
            the size of the image, the CRS, further columns of the file.

        Returns
        -------
        Fit
            The model as the features determine it.

        Raises
        ------
        Undetermined
            If the features do not determine the method, or do not support it.
        """

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of the features in use of a fit of this method, each held out.

        By default they are those that the estimator finds: of least squares in closed form, else by
        repeating the fit without each feature. A method that chooses repeats the choice; with
        `termsel.held_out_by_refits` that is one line.

        Returns
        -------
        HeldOut
            Of each feature, by the fit to the features that are left without it.

        Raises
        ------
        Undetermined
            If the features that are left do not determine the fit.
        """
        return fitted.estimator.held_out(fitted)

    def declines(self, data: FitData) -> str | None:
        """Return why the method is not for such features, as a clause; None if it is.

        It begins in lower case and has no full stop, such as "it needs heights".

        It is asked before every fit, so it should be quick.
        """
        return None

    def tried(self, data: FitData) -> bool:
        """Return whether auto tries the method on features that the method does not decline."""
        return True

    def refit(self, fitted: Fit, data: FitData) -> Fit:
        """Return the final fit: the structure of a fit that was chosen, fitted to more features.

        It raises what `fit` does.
        """
        return self.fit(data)

    def describe(self, fitted: Fit) -> str:
        """Return a sentence on why the features support a fit; "" if leave-one-out shows all."""
        return ""

    def doubt(self, fitted: Fit) -> str:
        """Return what is known of the image that features contradict and a fit leaves out; or "".

        It is a note of the result, in sentences.
        """
        return ""

    def nearly(self, data: FitData) -> bool:
        """Return whether parts of many features may support the method where all of them do not.

        It is asked where it could not be fitted to all of them. Then it is fitted in the folds in
        which the choice is repeated, unless it says no; that saves time.
        """
        return True

    def settles(self, data: FitData) -> str | None:
        """Return why features support this method alone, as a sentence; None if they do not.

        They do if points were computed by the very geometry that this method knows, for example. No
        other method is then tried.

        Raises
        ------
        TermselError
            If the features support this method alone, and it lacks something that the user must
            say: the run ends.
        """
        return None

    def suspects(self, data: FitData) -> Suspects | None:
        """Return which features contradict what the method knows of the image.

        None, the default, leaves them to the test by regularised polynomials.
        """
        return None

    def model(self, heights: bool) -> SensorModel | None:
        """Return the model for features with heights, or without; None where it depends."""
        return None

    def size(self, heights: bool) -> float:
        """Return the number of terms if that is fixed; the plainest are tried first."""
        return np.inf
