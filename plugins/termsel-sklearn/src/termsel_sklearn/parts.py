"""What both estimators share: a model or solver with its options, and weights of samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import _check_sample_weight

import termsel
from termsel import TermselError
from termsel_sklearn.arrays import FloatArray


class WithOptions(BaseEstimator):  # type: ignore[misc]
    """Base of estimators around one part, whose options are parameters as well.

    `options` holds those of a part that is given by its name or class. An instance has its own.
    """

    extension: ClassVar[str]
    """The parameter that is the part, such as "model"."""

    options: dict[str, Any] | None

    attributes_elsewhere: ClassVar[Mapping[str, str]] = {}
    """What is meant by attributes that other estimators have: a sentence by name."""

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError with what is meant by a name that the estimator does not have."""
        message = f"{type(self).__name__} has no {name!r}."
        is_fitted = any(key.endswith("_") and not key.startswith("_") for key in vars(self))
        if name.startswith("_"):
            meant = ""
        elif name.endswith("_") and not is_fitted:
            meant = "It is not fitted yet: call fit(X, y) first."
        else:
            meant = self.attributes_elsewhere.get(name, "")
        raise AttributeError(f"{message} {meant}".rstrip(), name=name)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters; with `deep` the options of the model or solver as well."""
        parameters: dict[str, Any] = super().get_params(deep)
        # Parameters of the estimator come before options of the same name.
        return {**self._option_values(), **parameters} if deep else parameters

    def set_params(self, **params: Any) -> Any:
        """Set parameters, or options of the model or solver, by their names; return the estimator.

        Raises ValueError for a name that is neither.
        """
        # Nested parameters have their own name before two underscores, as scikit-learn has it.
        own_parameters = {name: params.pop(name) for name in list(params)
                          if name.partition("__")[0] in self._get_param_names()}
        super().set_params(**own_parameters)
        option_values = self._option_values()
        for name in params:
            if name not in option_values:
                extension = getattr(self, self.extension)
                names = dict.fromkeys([*self._get_param_names(), *option_values])
                raise ValueError(f"Invalid parameter {name!r} for {type(self).__name__} with "
                                 f"{self.extension} {extension!r:.100}. Valid are: "
                                 f"{', '.join(names)}.")
        if params:
            self.options = {**(self.options or {}), **params}
        return self

    def _option_values(self) -> dict[str, Any]:
        """Return the value of each option of the model or solver, as set or by default.

        Returns {} for an instance, which has its own options, and for a name that is not known.
        """
        try:
            extension = self._given_extension()
        except TermselError:
            # `fit` raises the error: scikit-learn asks for parameters before that.
            return {}
        if not isinstance(extension, type):
            return {}
        # Options that are no dict are refused by `fit`, not here.
        set_options = self.options if isinstance(self.options, dict) else {}
        return {option.name: set_options.get(option.name, option.default)
                for option in extension.declared_options}  # type: ignore[attr-defined]

    def _given_extension(self) -> Any:
        """Return the class or instance of the model or solver that is given, by its name or itself.

        Raises TermselError for a name that is not known.
        """
        return termsel.get(f"{self.extension}s", getattr(self, self.extension))

    def _given_options(self) -> dict[str, Any]:
        """Return the options that are given, by name.

        Raises TermselError for what is no dict of them.
        """
        options = self.options or {}
        if not isinstance(options, dict):
            raise TermselError(f"options is {options!r:.60}, expected a dict",
                               hint="Such as options={'degree': 2}.")
        return options

    def _make_extension(self, **further: Any) -> Any:
        """Return an instance of the model or solver, made with `further` and then `options`.

        An instance that is given is returned as it is. Raises TermselError if there are options for
        it, or if the class refuses the options.
        """
        extension = self._given_extension()
        options = {**further, **self._given_options()}
        if isinstance(extension, type):
            return extension(**options)
        if options:
            raise TermselError(f"option {next(iter(options))!r} is for the {self.extension} "
                               f"{extension.name!r}, which has its options already",
                               hint="Give them with the name or the class of the "
                                    f"{self.extension}.")
        return extension


def weights_of(sample_weight: Any, X: FloatArray) -> FloatArray:
    """Return the weight of each row of X, shape (n,): 1 for None.

    Raises ValueError for weights of another length, and for one that is negative or not finite.
    """
    weights = np.array(_check_sample_weight(sample_weight, X, dtype=np.float64))
    if (weights < 0).any():
        raise ValueError("sample_weight has negative values")
    return weights
