"""A model that the user names, as the only method: all its terms, fitted to all control."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import KW_ONLY, dataclass, replace

from termsel.auto.auto import Auto, unjudged_fit
from termsel.auto.methods import METHODS, Structure
from termsel.core.errors import count_in_words
from termsel.data.fit_data import FitData
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.fitting.method import Method
from termsel.models.base import SensorModel

_SIZES = ("degree", "order")
"""Options of models that say how many terms they have."""


@dataclass(frozen=True, eq=False)
class NamedModel(Structure):
    """All terms of one model by least squares, whatever the heights of the features.

    Parameters
    ----------
    given : collection of str
        Names of the options that the user gave. A degree or order among them is not lowered.
    """

    _: KW_ONLY
    on_request: bool = True
    given: Collection[str] = ()

    @property
    def sensor_model(self) -> SensorModel:
        """The model."""
        assert self.with_heights is not None
        return self.with_heights

    @property
    def size_option(self) -> str | None:
        """The option that says how many terms the model has; None without one."""
        return next((name for name in _SIZES if name in self.sensor_model.options), None)

    def tried(self, data: FitData) -> bool:
        """Return True: what is known of a camera may make up for equations that are missing."""
        return True

    def lowered(self) -> Iterator[NamedModel]:
        """Yield the model, then with each lower degree or order, unless the user gave it."""
        yield self
        size = self.size_option
        if size is None or size in self.given:
            return
        for value in range(self.sensor_model.options[size] - 1, 0, -1):
            yield named_model(self.sensor_model.with_parameters({size: value}), self.given)


def named_model(model: SensorModel, given: Collection[str]) -> NamedModel:
    """Return a model as a method, under the name of the model; options `given` are the user's."""
    return NamedModel(model.name, f"the model {model.name}", model, model, given=given)


def as_far_as_determined(auto: Auto, data: FitData) -> tuple[Auto, str]:
    """Return the choice of a named model with its degree as high as features allow, and a note.

    That is the highest at which each feature is predicted by the others, else the highest that the
    features determine at all, else the lowest. Only a model whose degree the user left open is
    lowered; the note says so, and is "" otherwise. A model that a built-in method fits goes by the
    name of that method. A choice among several methods is returned as it is.
    """
    named = auto.methods[0]
    if not (auto.is_one_method and isinstance(named, NamedModel)):
        return auto, ""
    lowered = list(named.lowered())
    predicting = (method for method in lowered if auto.validated(method, data) is not None)
    determined = (method for method in lowered if unjudged_fit(data, method) is not None)
    chosen = next(predicting, None) or next(determined, None) or lowered[-1]
    note = "" if chosen is named else _note_on_size(chosen, named, data)
    return replace(auto, methods=(_built_in(chosen, data),)), note


def _built_in(named: NamedModel, data: FitData) -> Method:
    """Return the method by the names of the built-in one that fits the same terms, if there is one.
    """
    model = named.sensor_model
    for method in METHODS:
        own_model = method.model(data.heights)
        if (own_model is not None and type(own_model) is type(model)
                and own_model.terms == model.terms
                and all(own_model.options[name] == model.options[name] for name in named.given)
                and method.estimator == LEAST_SQUARES and method.is_plain
                and method.declines(data) is None):
            # Not the built-in method itself, which leaves heights out of parts of the features
            # where they look plane: each part is fitted with all terms of the model that was named.
            return replace(named, name=method.name, title=method.title, short=method.short,
                           with_heights=own_model, without=own_model, is_plain=method.is_plain,
                           central=method.central)
    return named


def _note_on_size(chosen: NamedModel, named: NamedModel, data: FitData) -> str:
    """Return the note that the degree of the model was lowered for want of features."""
    size = named.size_option
    assert size is not None
    features = count_in_words(len(data), data.features.word.removesuffix("s"))
    return (f"{features} {'is' if len(data) == 1 else 'are'} too few for {size} "
            f"{named.sensor_model.options[size]} of {named.name}, so {size} "
            f"{chosen.sensor_model.options[size]} was fitted. --set {size}=N takes another.")
