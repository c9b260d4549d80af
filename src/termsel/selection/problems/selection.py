"""Selection of model terms, of control features, or of both."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from termsel.adjustment.leave_out import independent_parts, solve_parts
from termsel.adjustment.solve import ROUNDING, replace_rounding_by_size
from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.remedies import Remedy
from termsel.data.coordinates.places import feature_centres
from termsel.data.features import BoolArray, FloatArray, IntArray, select
from termsel.fitting.least_squares import first_order_equations
from termsel.fitting.population import Fits
from termsel.models.base import LINE, SAMPLE, SensorModel
from termsel.models.quotient import RationalModel, guard_points, pole_margin, pole_violation
from termsel.models.terms import Term
from termsel.selection.criteria import Criterion
from termsel.selection.problems.base import (
    WORST,
    EnumerablePart,
    Evaluation,
    Problem,
    ProblemData,
    Selection,
)
from termsel.selection.problems.constraints import (
    cap_segments,
    count_excess_terms,
    count_orphans,
    forced_labels,
    parent_pairs,
    split_names,
)
from termsel.selection.problems.coverage import uncovered_share
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.objectives import PopulationSelection, figures_of_objective
from termsel.selection.problems.segments import AnySegment, Bits, Genes, Subset

if TYPE_CHECKING:
    from termsel.selection.best_subsets.features.walk import RowSystem


class SelectionProblem(Problem):
    """Select terms, features or both; fit by least squares; score by the criterion.

    Parameters
    ----------
    inputs : ProblemData
    terms, features : bool
        What the chromosome selects. All of what it does not select is in use.
    mask : {"per-axis", "shared"}
        Whether line and sample have separate genes for a monomial, or share one.
    subset : bool
        Whether features of a fixed number, where min_features and max_features are the same, are a
        `Subset`: m whole numbers instead of n bits.

    Raises
    ------
    TermselError
        If the model does not allow this selection, or there is too little control.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> problem = termsel.prepare("poly-terms", options={"degree": 2}).problem
    >>> type(problem).__name__
    'SelectionProblem'
    >>> genes = problem.genome.random(np.random.default_rng(1), 5)
    >>> problem.evaluate(genes).objectives.shape
    (5, 1)
    """

    def __init__(self, inputs: ProblemData, *, terms: bool, features: bool,
                 mask: str = "per-axis", subset: bool = False) -> None:
        """Lay out the genome of what is selected; raises TermselError as the class says."""
        model = inputs.model
        control = inputs.control
        self.inputs = inputs
        # The criterion comes first: by it solvers of one objective rank.
        further = [objective.name for objective in inputs.objectives]
        self.objectives = (inputs.criterion.name, *further)
        self.equations = first_order_equations(model, control)
        if _iterated_model(inputs) and not inputs.criterion.needs_check:
            raise TermselError("weighted=true judges selections by selection points",
                               hint=f"Choose {Remedy('criterion', 'check-rmse')}.")
        # Denominators must be positive at all of these, wherever the image is used.
        self._guard = guard_points(control, inputs.check)
        self._margin = pole_margin(control)
        self._parts = independent_parts(self.equations, model.axis)
        names = model.terms
        segments: list[Bits | Subset] = []
        self._gene_of_term: IntArray | None = None
        share = inputs.options.get("max_share")
        self._share = 1.0 if share is None else float(share)
        if terms:
            term_segments, self._gene_of_term = _term_segments(names, model.axis, mask)
            segments += (cap_segments(term_segments, self._gene_of_term, self._parts, self._share)
                         if self._share < 1 else term_segments)
        # Genes of terms come first, those of features after them.
        self._n_term_genes = sum(len(s.labels) for s in segments)
        self._selects_features = features
        if features:
            if model.corrects and not inputs.criterion.needs_check:
                raise TermselError(
                    f"features of model {model.name!r} cannot be selected without selection "
                    "points: it corrects its predictions by "
                    "control", hint=f"Choose {Remedy('criterion', 'check-rmse')}.")
            min_features, max_features = _feature_counts(inputs)
            if subset and min_features == max_features:
                segments.append(Subset("features", control.ids, min_features))
            else:
                segments.append(Bits("features", control.ids, min_features, max_features))
        self._terms_in_use = _terms_in_use(inputs)
        labels: tuple[str, ...] = ()
        for segment in segments:
            if segment.name != "features":
                labels += segment.labels
        ids = control.ids if features else ()
        self.genome = Genome(segments,
                             on=forced_labels(inputs.options.get("force_on"), labels, ids),
                             off=forced_labels(inputs.options.get("force_off"), labels, ids))
        self._pairs = parent_pairs(names) if inputs.options.get("hierarchy") else None
        self._require_solvable(terms)

    def frozen(self, labels_on: BoolArray, frozen_labels: BoolArray) -> SelectionProblem:
        """Return the problem with some labels of the genome frozen, so that no search changes them.

        `frozen_labels` (labels,) says which labels are frozen, `labels_on` (labels,) which of these
        stay on. A segment that is frozen as a whole need no longer keep its minimum and maximum. If
        all terms are frozen and are more than max_share allows, that limit no longer holds.
        """
        genome = self.genome
        segments: list[AnySegment] = []
        for segment, columns in zip(genome.segments, genome.label_slices().values(), strict=True):
            # A subset that has its number of members can stay what it is.
            keeps_count = isinstance(segment, Subset) and labels_on[columns].sum() == segment.m
            if frozen_labels[columns].all() and not keeps_count:
                segments.append(Bits(segment.name, segment.labels))
            else:
                segments.append(segment)
        problem = copy(self)
        on = np.where(frozen_labels, labels_on, genome.on)
        off = np.where(frozen_labels, ~labels_on, genome.off)
        problem.genome = Genome(segments, on=select(genome.labels, on),
                                off=select(genome.labels, off))
        if frozen_labels[:self._n_term_genes].all() and count_excess_terms(
                self._parts, self._masks(labels_on[None])[0], None, self._share).any():
            problem._share = 1.0
        return problem

    def judged_by(self, criterion: Criterion) -> SelectionProblem:
        """Return the problem with another criterion as its only objective."""
        # All else is shared: equations and parts do not depend on the criterion.
        problem = copy(self)
        problem.inputs = replace(self.inputs, criterion=criterion, objectives=())
        problem.objectives = (criterion.name,)
        return problem

    def with_model(self, model: SensorModel) -> SelectionProblem:
        """Return the problem with another model, which must have the same terms, for its features.

        Raises TermselError if it has other terms.
        """
        if model.terms != self.inputs.model.terms:
            raise TermselError(f"model {model.name!r} with other options has other terms, so they "
                               "cannot be selected at the same time",
                               hint="Choose a problem that searches these options alone.")
        # Genome and guard points depend on terms and features alone, and are shared.
        problem = copy(self)
        problem.inputs = replace(self.inputs, model=model)
        problem.equations = first_order_equations(model, self.inputs.control)
        problem._parts = independent_parts(problem.equations, model.axis)
        return problem

    def _require_solvable(self, selects_terms: bool) -> None:
        """Raise TermselError for control that no selection could solve the model from.

        Sets `_least_freedom`, the redundancy that a selection must have: 1, or 0 where features
        alone are selected and the user limits their number.
        """
        max_features = _feature_counts(self.inputs)[1] if self._selects_features else None
        # A user may ask for so few features that the model is just determined.
        self._least_freedom = 1 if max_features is None or selects_terms else 0
        for part in self._parts:
            columns = int(self._terms_in_use[part.columns].sum())
            # The features with the most rows: no selection of so many has more equations.
            rows_of_feature = np.sort(np.bincount(part.equations.feature))[::-1]
            rows = rows_of_feature[:max_features].sum()
            if not selects_terms and rows < columns + self._least_freedom:
                message = (f"model {self.inputs.model.name!r} has {columns} terms to be determined "
                           f"together; the control gives {rows} equations")
                remedy = "Give more control"
                if max_features is not None:
                    message += f" with at most {max_features} features"
                    remedy = "Raise max_features"
                if rows == columns:
                    message += ", so there is no redundancy"
                raise TermselError(
                    message, hint=f"{remedy}, lower the order or degree of the model (--set "
                                  "order=1, --set degree=1), or select terms.")

    def evaluate(self, genes: Genes) -> Evaluation:
        """Return the criterion and the violation of a population (see `Problem.evaluate`).

        The violation is the sum of:

        - the number of terms that are not determined;
        - the number of terms in excess of what the equations support (option "max_share", and one
          degree of freedom);
        - the number of axes without a term of the numerator;
        - the number of parents that are missing (option "hierarchy");
        - how far a denominator is below `termsel.models.quotient.pole_margin` somewhere in the
          scene;
        - how far the uncovered share of the image is above the option "max_uncovered".

        It is 1 where all of these are 0 and the criterion has no figure.

        Raises TermselError for what are no genes, such as fractions for bits.
        """
        return self._evaluate(self.genome.population(genes))

    def evaluate_near(self, genes: Genes, near: Genes) -> Evaluation:
        """Return the evaluation of neighbours (see `Problem.evaluate_near`)."""
        if type(self).evaluate is not SelectionProblem.evaluate:  # a plugin's own
            return self.evaluate(genes)
        return self._evaluate(genes, self.masks(near[None])[1])

    def _evaluate(self, genes: Genes, near: BoolArray | None = None) -> Evaluation:
        """Return the evaluation of a population (see `evaluate`).

        Only individuals that violate nothing are scored. `near` (1, n) is a selection of features
        of which these individuals are neighbours: its solution is corrected then, where that is
        possible.
        """
        inputs = self.inputs
        terms, features = self.masks(genes)
        coefficients, violation = self._solve(terms, features, near)
        # The figure of an individual that is not determined, or has a pole in the scene, would
        # mean nothing.
        is_feasible = violation == 0
        score = np.full(len(genes), WORST)
        if is_feasible.any():
            optional_terms = None
            if self._gene_of_term is not None:
                optional_terms = self.genome.free[self._gene_of_term]
            score[is_feasible] = inputs.criterion.score(Fits(
                model=inputs.model, control=inputs.control.points, check=inputs.check,
                pixels=inputs.pixels, terms=terms[is_feasible],
                coefficients=coefficients[is_feasible],
                lines=inputs.control.lines, parts=self._parts,
                used=None if features is None else features[is_feasible],
                gene_of_term=self._gene_of_term, optional=optional_terms))
            if inputs.criterion.is_rmse or inputs.criterion.in_px:
                # Figures that are rounding of the data are ordered by the share of genes on.
                share = self.genome.chosen(genes[is_feasible]).mean(axis=1)
                # An infinite figure, of either sign, is none.
                figures = score[is_feasible]
                score[is_feasible] = np.where(np.isinf(figures), figures, replace_rounding_by_size(
                    figures, ROUNDING * inputs.pixels, np.sqrt(share)))
        # Objectives are finite, always: an individual without a figure is infeasible, and has the
        # worst one.
        violation[~np.isfinite(score)] = 1.0
        score = np.minimum(np.nan_to_num(score, nan=WORST, posinf=WORST, neginf=WORST), WORST)
        return Evaluation(self._all_objectives(score, terms, features), violation)

    def _solve(self, terms: BoolArray, features: BoolArray | None, near: BoolArray | None,
               ) -> tuple[FloatArray, FloatArray]:
        """Return coefficients (p, k) by least squares, and what each individual violates (p,).

        Violations are terms beyond the equations, axes without terms, poles in the scene, features
        that leave a part of it uncovered, and terms without their parents.
        `near` is as in `_evaluate`.
        """
        inputs = self.inputs
        model = _iterated_model(inputs)
        # A solution can be corrected where all terms are in use, and all individuals have the same
        # equations.
        can_correct = (model is None and self._gene_of_term is None and self._terms_in_use.all())
        start = near[0] if near is not None and can_correct else None
        coefficients, violation = solve_parts(self._parts, terms, features, start)
        if model is not None:
            is_determined = violation == 0
            coefficients[is_determined] = model.least_distances(
                inputs.control.points, self._parts, terms[is_determined],
                None if features is None else features[is_determined])
        # Where terms are not selected all individuals have the same: one row stands for all.
        distinct_terms = terms[:1] if self._gene_of_term is None else terms
        violation += count_excess_terms(
            self._parts, distinct_terms, features, self._share, self._least_freedom)
        violation += self._empty_axes(distinct_terms)
        violation += pole_violation(inputs.model, coefficients, self._guard, self._margin)
        violation += self._excess_uncovered(features)
        if self._pairs is not None:
            violation += count_orphans(terms, self._pairs)
        return coefficients, violation

    def lacks_figure(self, genes: Genes) -> bool:
        """Return whether nothing but a figure of the criterion is missing from an individual.

        A criterion that the user wrote may be at fault then, where more evaluations or control
        cannot help.
        """
        terms, features = self.masks(genes[None])
        _, violation = self._solve(terms, features, None)
        return bool(violation[0] == 0.0 and self.evaluate(genes[None]).violation[0] > 0.0)

    def _excess_uncovered(self, features: BoolArray | None) -> FloatArray | float:
        """Return how far the uncovered share of the image exceeds its limit, (p,); 0.0 without one.

        `features` (p, n) are masks of the selections, None where features are not selected.
        """
        max_uncovered = self.inputs.options.get("max_uncovered")
        if features is None or max_uncovered is None:
            return 0.0
        share = uncovered_share(feature_centres(self.inputs.control), features)
        return np.asarray(np.maximum(share - max_uncovered, 0.0))

    def _all_objectives(self, score: FloatArray, terms: BoolArray,
                        features: BoolArray | None) -> FloatArray:
        """Return the criterion and the further objectives, in their order, shape (p, m).

        `score` (p,) are the values of the criterion. `terms` (p, k) and `features` (p, n) are the
        terms and control features that each of p individuals selects; None selects all features.
        """
        if len(self.objectives) == 1:
            return score[:, None]
        control = self.inputs.control
        if features is None:
            features = np.ones((len(terms), len(control)), dtype=bool)
        selected = PopulationSelection(self.equations, self._parts, control, terms, features)
        further = [figures_of_objective(objective, selected)
                   for objective in self.inputs.objectives]
        return np.column_stack([score, *further])

    def masks(self, genes: Genes) -> tuple[BoolArray, BoolArray | None]:
        """Return masks of terms, shape (p, k), and of features, shape (p, f) or None for all."""
        return self._masks(self.genome.chosen(genes))

    def _masks(self, labels_on: BoolArray) -> tuple[BoolArray, BoolArray | None]:
        """Return masks of terms (p, k) and of features (p, n) from the labels that are on.

        The mask of features is None where the problem selects terms alone.
        """
        if self._gene_of_term is None:
            terms = np.repeat(self._terms_in_use[None], len(labels_on), axis=0)
        else:
            terms = labels_on[:, self._gene_of_term]
        return terms, labels_on[:, self._n_term_genes:] if self._selects_features else None

    def decode(self, genes: Genes) -> Selection:
        """Return the names of the terms and features in use.

        Raises TermselError for what are no genes.
        """
        terms, features = self.masks(self.genome.population(np.atleast_2d(genes)))
        ids = self.inputs.control.ids
        return Selection(select(self.inputs.model.terms, terms[0]),
                         ids if features is None else select(ids, features[0]))

    def parts(self) -> tuple[EnumerablePart, ...]:
        """Return line and sample as parts that can be enumerated (see `Problem.parts`)."""
        if self._gene_of_term is None or self._selects_features:
            return super().parts()
        from termsel.selection.problems.enumeration import (  # for those who enumerate
            enumerable_parts,
        )

        return enumerable_parts(self.inputs, self.equations, self.genome,
                                gene_of_term=self._gene_of_term, guard=self._guard,
                                margin=self._margin, pairs=self._pairs)

    def row_systems(self) -> tuple[RowSystem, ...] | None:
        """Return the parts of a selection of features alone (see `Problem.row_systems`).

        Returns None where terms are selected; () where no rows say what a selection scores, as a
        plugin evaluates it, or each selection has equations of its own.
        """
        if self._gene_of_term is not None or not self._selects_features:
            return None
        if type(self).evaluate is not SelectionProblem.evaluate or _iterated_model(self.inputs):
            return ()
        from termsel.selection.problems.feature_rows import row_systems

        return row_systems(self.inputs, self._parts, self._terms_in_use, self._share,
                           self._least_freedom)

    def design(self) -> FloatArray:
        """Return the columns of the adjustment by gene, shape (m, size).

        The m rows are the equations. A gene that switches a line term and a sample term has the
        columns of both, one on top of the other. Raises TermselError unless terms alone are
        selected.
        """
        gene = self._gene_of_term
        A = self.equations.A
        axis = self.inputs.model.axis
        if gene is None or self._selects_features:
            return super().design()
        # Rows and terms of each block.
        selections = [(np.ones(len(A), dtype=bool), np.ones(len(axis), dtype=bool))]
        if len(gene) > self.genome.size:
            # A shared mask: line, then sample, each with the terms that belong to both.
            selections = [((A[:, axis == image_axis] != 0).any(axis=1), axis != other_axis)
                          for image_axis, other_axis in ((LINE, SAMPLE), (SAMPLE, LINE))]
        blocks = []
        for rows, terms in selections:
            block = np.zeros((rows.sum(), self.genome.size))
            block[:, gene[terms]] = A[np.ix_(rows, terms)]
            blocks.append(block)
        return np.concatenate(blocks)

    def _empty_axes(self, terms: BoolArray) -> FloatArray:
        """Return how many axes, 0 to 2, have none of the terms that masks (p, k) select, (p,).

        A model whose terms are not all of line or of sample has 0.
        """
        axis = self.inputs.model.axis
        if not np.isin([LINE, SAMPLE], axis).all():
            return np.zeros(len(terms))
        # 0, 1 or 2: an axis without a term has no model at all.
        line = terms[:, axis == LINE]
        sample = terms[:, axis == SAMPLE]
        return np.asarray(2.0 - line.any(axis=1) - sample.any(axis=1))


def _iterated_model(inputs: ProblemData) -> RationalModel | None:
    """Return the model if its equations are iterated for each selection of points; else None."""
    model = inputs.model
    if isinstance(model, RationalModel) and model.weighted and not len(inputs.control.lines):
        return model
    return None


def _terms_in_use(inputs: ProblemData) -> BoolArray:
    """Return which terms are in use where they are not selected, shape (k,).

    Raises TermselError for the name of a term that the model does not have.
    """
    names = inputs.model.terms
    selected = split_names(inputs.options.get("terms"))
    for name in selected:
        if name not in names:
            raise unknown_name_error("term", name, names)
    return np.array([not selected or name in selected for name in names])


def _feature_counts(inputs: ProblemData) -> tuple[int, int | None]:
    """Return the options `min_features`, 0 if it is not given, and `max_features`, None if not.

    Raises TermselError where they contradict each other or the number of features.
    """
    n = len(inputs.control)
    counts = {name: inputs.options.get(name) for name in ("min_features", "max_features")}
    for name, count in counts.items():
        if count is not None and not 1 <= count <= n:
            raise TermselError(f"option {name!r} is {count}; there are {n} control features to "
                               "select from", hint=f"Give a number from 1 to {n}.")
    min_features, max_features = counts.values()
    if min_features is not None and max_features is not None and min_features > max_features:
        raise TermselError(f"option 'min_features' is {min_features}, more than 'max_features', "
                           f"{max_features}",
                           hint="Lower min_features or raise max_features.")
    return min_features or 0, max_features


def _term_segments(names: tuple[str, ...], axis: IntArray, mask: str,
                   ) -> tuple[list[Bits], IntArray]:
    """Return the segments of term genes, and the gene that switches each of the k terms, (k,).

    `axis` (k,) is the image axis of each term; `mask` is "shared" where one gene switches a
    monomial in line and in sample.
    """
    if mask == "shared":
        # "line.num:X2Y" and "sample.num:X2Y" share the gene "num:X2Y".
        label_of_term = [str(Term.parse(name).shared) for name in names]
        labels = tuple(dict.fromkeys(label_of_term))
        return ([Bits("terms", labels)],
                np.array([labels.index(label) for label in label_of_term], dtype=np.intp))
    segments: list[Bits] = []
    order: list[int] = []
    for image_axis, title in ((0, "terms.line"), (1, "terms.sample"), (2, "terms.shared")):
        numbers = np.flatnonzero(axis == image_axis)
        if numbers.size:
            segments.append(Bits(title, tuple(names[i] for i in numbers)))
            order.extend(int(i) for i in numbers)
    # Genes are in the order of the segments, terms in that of the model.
    gene = np.empty(len(names), dtype=np.intp)
    gene[order] = np.arange(len(names))
    return segments, gene
