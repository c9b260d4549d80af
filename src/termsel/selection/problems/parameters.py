"""Values of a model's options, searched alone or together with its terms."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.options import Option
from termsel.data.features import select
from termsel.selection.problems.base import Evaluation, Problem, ProblemData, Selection
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import AnySegment, Categories, Genes, Integers, Reals
from termsel.selection.problems.selection import SelectionProblem

_MAX_CACHED = 500


class ParameterProblem(Problem):
    """Search values of a model's options; fit by least squares; score by the criterion.

    Each parameter is a segment of its own: whole numbers are `Integers` and others `Reals` between
    the bounds of the option; choices and true or false are `Categories`.

    Parameters
    ----------
    inputs : ProblemData
    parameters : iterable of str
        Names of options of the model.
    terms : bool
        Whether terms are selected too, which the parameters must not change. By default all terms
        of the model with these parameters are in use.
    mask : {"per-axis", "shared"}
        As for `SelectionProblem`.

    Raises
    ------
    TermselError
        If the model has no such option, or one without bounds.

    Examples
    --------
    >>> import termsel
    >>> class Degrees(termsel.ParameterProblem):
    ...     "The degree of a polynomial, as a whole number."
    ...
    ...     def __init__(self, inputs):
    ...         super().__init__(inputs, parameters=["degree"])
    >>> problem = Degrees(termsel.prepare("poly-terms").inputs)
    >>> found = termsel.search(problem, termsel.get("solvers", "random")(), evaluations=20)
    >>> problem.decode(found.genes).parameters, round(float(found.objectives[0]), 2)  # RMSE [px]
    ({'degree': 3}, 2.95)
    """

    def __init__(self, inputs: ProblemData, parameters: Iterable[str], *, terms: bool = False,
                 mask: str = "per-axis") -> None:
        """Make a segment of each option of the model; raises TermselError as the class says."""
        self.inputs = inputs
        self._selects_terms = terms
        options = {option.name: option for option in inputs.model.declared_options}
        self.parameters = tuple(parameters)
        for name in self.parameters:
            if name not in options:
                raise unknown_name_error("option", name, options,
                                         f"The problem needs a model with this option, and "
                                         f"{inputs.model.name!r} has none.")
        self._base = base = SelectionProblem(inputs, terms=True, features=False, mask=mask)
        self.objectives = base.objectives
        segments: list[AnySegment] = [segment_of(options[name]) for name in self.parameters]
        if terms:
            segments = [*base.genome.segments, *segments]
        # Genes of terms come first, those of the parameters after them.
        self._n_terms = base.genome.size if terms else 0
        self.genome = Genome(
            segments, on=select(base.genome.labels, base.genome.on) if terms else (),
            off=select(base.genome.labels, base.genome.off) if terms else ())
        self._known: dict[bytes, SelectionProblem] = {}

    def evaluate(self, genes: Genes) -> Evaluation:
        """Return the criterion and the violation of genes (p, size).

        Each individual is evaluated as `SelectionProblem.evaluate` does with the model that its
        parameters give; without selection of terms, it has all terms of that model.

        Raises TermselError for what are no genes.
        """
        genes = self.genome.population(genes)
        objectives = np.empty((len(genes), len(self.objectives)))
        violation = np.empty(len(genes))
        # A model, and its problem, for each set of parameters in the population.
        different, group = np.unique(genes[:, self._n_terms:], axis=0, return_inverse=True)
        for i, row in enumerate(different):
            same_parameters = np.flatnonzero(group.ravel() == i)
            problem = self._selection_at(row)
            # Without a selection all with these parameters are the same.
            evaluated = same_parameters if self._selects_terms else same_parameters[:1]
            evaluation = problem.evaluate(self._genes_of_terms(genes[evaluated], problem))
            objectives[same_parameters] = evaluation.objectives
            violation[same_parameters] = evaluation.violation
        return Evaluation(objectives, violation)

    def decode(self, genes: Genes) -> Selection:
        """Return the terms in use and the values of the parameters.

        Raises TermselError for what are no genes.
        """
        genes = self.genome.population(np.atleast_2d(genes))[0]
        problem = self._selection_at(genes[self._n_terms:])
        selection = problem.decode(self._genes_of_terms(genes[None], problem))
        return replace(selection, parameters=self._values_by_name(genes[self._n_terms:]))

    def _values_by_name(self, genes: Genes) -> dict[str, Any]:
        """Return the parameters that genes stand for, by name."""
        # The genome shows values of whole chromosomes; those of terms play no part.
        all_genes = np.concatenate([np.zeros(self._n_terms, dtype=genes.dtype), genes])
        values = self.genome.values(all_genes)
        return {name: values[name][name] for name in self.parameters}

    def _selection_at(self, genes: Genes) -> SelectionProblem:
        """Return the problem of selecting terms of the model that some parameters give.

        `genes` (n,) are those of one individual that stand for its n parameters.
        """
        key = genes.tobytes()
        if key not in self._known:
            # Each holds the equations of its model: they are made again rather than kept for ever.
            if len(self._known) >= _MAX_CACHED:
                self._known.clear()
            model = self.inputs.model.with_parameters(self._values_by_name(genes))
            if self._selects_terms:
                self._known[key] = self._base.with_model(model)
            else:
                self._known[key] = SelectionProblem(replace(self.inputs, model=model), terms=True,
                                                    features=False)
        return self._known[key]

    def _genes_of_terms(self, genes: Genes, problem: SelectionProblem) -> Genes:
        """Return the genes of the terms, shape (p, genes of the problem)."""
        if self._selects_terms:
            return genes[:, :self._n_terms].astype(bool)
        return np.ones((len(genes), problem.genome.size), dtype=bool)


def segment_of(option: Option) -> Categories | Integers | Reals:
    """Return a segment for the values of an option; its name and that of its gene are the option's.

    Raises TermselError for text that may be anything, and for numbers without bounds.
    """
    name = option.name
    bounds = (option.minimum, option.maximum)
    # Choices come first: text or numbers of which only some are allowed.
    if option.choices:
        return Categories(name, (name,), option.choices)
    if option.type is bool:
        return Categories(name, (name,), (False, True))
    if option.type not in (int, float) or None in bounds:
        raise TermselError(f"option {name!r} has no bounds to search within",
                           hint="A parameter needs choices, or a least and a greatest value.")
    return (Integers if option.type is int else Reals)(name, (name,), *bounds)
