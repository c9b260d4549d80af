"""What both estimators share: a model or solver with its options, and weights of samples."""

from __future__ import annotations

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

    part: ClassVar[str]
    """The parameter that is the part, such as "model"."""

    options: dict[str, Any] | None

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters; with `deep` the options of the model or solver as well."""
        own: dict[str, Any] = super().get_params(deep)
        return {**self._values(), **own} if deep else own

    def set_params(self, **params: Any) -> Any:
        """Set parameters, or options of the model or solver by their names."""
        own = {name: params.pop(name) for name in list(params)
               if name.partition("__")[0] in self._get_param_names()}
        super().set_params(**own)
        known = self._values()
        for name in params:
            if name not in known:
                given = getattr(self, self.part)
                names = [*self._get_param_names(), *known]
                raise ValueError(f"Invalid parameter {name!r} for {type(self).__name__} with "
                                 f"{self.part} {given!r:.100}. Valid are: {', '.join(names)}.")
        if params:
            self.options = {**(self.options or {}), **params}
        return self

    def _values(self) -> dict[str, Any]:
        """Return the options by name, as they are set; none of an instance or unknown name."""
        try:
            given = self._taken()
        except TermselError:  # which `fit` says
            return {}
        if not isinstance(given, type):
            return {}
        set_ones = self.options if isinstance(self.options, dict) else {}  # `fit` refuses others
        return {option.name: set_ones.get(option.name, option.default)
                for option in given.declared_options}  # type: ignore[attr-defined]

    def _taken(self) -> Any:
        """Return the class or instance that is given, perhaps by name."""
        return termsel.get(f"{self.part}s", getattr(self, self.part))

    def _made(self, **further: Any) -> Any:
        """Return the part with its options."""
        part = self._taken()
        options = {**further, **(self.options or {})}
        if isinstance(part, type):
            return part(**options)
        if options:
            raise TermselError(f"option {next(iter(options))!r} is for the {self.part} "
                               f"{part.name!r}, which has its options already",
                               hint=f"Give them with the name or the class of the {self.part}.")
        return part


def weights_of(sample_weight: Any, X: FloatArray) -> FloatArray:
    """Return the weight of each row of X, shape (n,); raise ValueError for one below 0."""
    weights = np.array(_check_sample_weight(sample_weight, X, dtype=np.float64))
    if (weights < 0).any():
        raise ValueError("sample_weight has negative values")
    return weights
