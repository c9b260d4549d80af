"""What was selected, and why: the choice or the search, its proofs, its front, its terms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import cast

from termsel.core.errors import amount_in_words, count_in_words, percent_text, rounded_size_text
from termsel.data.record.figures import SIGNIFICANT, AdjustmentFigures, RoleRmse, SensorFigure
from termsel.data.record.record import Record
from termsel.data.record.search import Certificate, Member, SizeRow, Strategy
from termsel.fitting.figures import CORRELATED
from termsel.results import sizes
from termsel.results.blocks import Block, Detail, Figure, Names, TableBlock
from termsel.results.charts import search
from termsel.results.first_screen import share_in_words
from termsel.results.plots import chart_block, why_chart_missing
from termsel.results.tables import OF_TERMS
from termsel.results.verdict import criterion_in_words, label_of
from termsel.results.view import View


def blocks_on_selection(record: Record, view: View | None, picture: str) -> Iterator[Block]:
    """Yield how the selection was found and what is proven of it, then its figures and names.

    Charts and their tables are for a page, which has a `view`; `picture` is the image there,
    smaller, as a data URL. Names of features and terms are listed where some were not selected.
    """
    if record.strategy:
        yield from _choice_table(record, record.strategy, view)
    else:
        yield from map(Detail, _sentences_on_search(record))
        yield from _proof_of_selection(record)
    yield from _front_and_proofs(record, view, picture)
    if record.sensor:
        yield Detail(_sensor_table(record.sensor))
        if any(sensor.name == "kappa" for sensor in record.sensor):
            yield Detail(ANGLES)
    yield from map(Detail, _sentences_on_coefficients(record))
    if view is not None:
        # Charts of terms, each with its table for those who cannot see it.
        drawable = [name for name in OF_TERMS if not why_chart_missing(view, name)]
        for name in drawable:
            yield from chart_block(view, name)
        yield from (table(view) for name in drawable if (table := OF_TERMS[name]) is not None)
    selection = record.selection
    offered = record.offered
    if selection.n_features < offered.n_features and not record.strategy:
        yield Detail(Names("Features", selection.features))
    if selection.n_terms < offered.n_terms:
        yield Detail(Names("Terms", selection.terms))


ANGLES = ("omega, phi and kappa are those of R3(kappa) R2(phi) R1(omega), which turns axes of the "
          "ground (x, y and upwards at the middle of the control) to those of the image: x along "
          "samples, y against lines, z against the view. Lines and samples count from the centre "
          "of the upper-left pixel.")
"""The convention of the angles of a photo."""


def _sensor_table(figures: Sequence[SensorFigure]) -> TableBlock:
    """Return the figures of a sensor as a table, with standard deviations where these are known."""
    rows = []
    for sensor in figures:
        deviation = sensor.standard_deviation
        uncertainty = "" if deviation is None else _figure_with_unit(sensor, deviation)
        rows.append((sensor.name, _figure_with_unit(sensor, sensor.value), uncertainty,
                     sensor.unit))
    if any(sensor.standard_deviation is not None for sensor in figures):
        return TableBlock("Sensor", ("", "value", "standard deviation", "unit"), rows)
    return TableBlock("Sensor", ("", "value", "unit"), [
        (name, value, unit) for name, value, _, unit in rows])


_DECIMALS = {"px": 2, "m": 2, "ft": 2, "us-ft": 2, "deg": 4}
"""Decimals of a figure of a sensor by its unit; those of longitude and latitude are more."""

_PLACE_DECIMALS = 8
"""Decimals of a longitude or latitude [deg]: a millimetre."""


def _figure_with_unit(sensor: SensorFigure, value: float) -> str:
    """Return a value with the decimals that the unit of a figure of a sensor has."""
    is_place = sensor.unit == "deg" and sensor.name.startswith("projection centre")
    decimals = _PLACE_DECIMALS if is_place else _DECIMALS.get(sensor.unit, 4)
    return f"{value:.{decimals}f}"


def _iteration_in_words(adjustment: AdjustmentFigures) -> str:
    """Return how the iteration of a fit ended, after a comma; "" where there was none."""
    if adjustment.steps is None:
        return ""
    ending = "converged" if adjustment.converged else "has not converged"
    return f"; the fit {ending} after {count_in_words(adjustment.steps, 'step')}"


def _choice_table(record: Record, strategy: Strategy, view: View | None) -> Iterator[Block]:
    """Yield a table of the models with their leave-one-out RMSE, the chosen one marked."""
    models = strategy.candidates
    yield Detail(f"Chosen: {label_of(strategy.chosen)}, fitted to control and selection points; "
                 f"{record.seconds:.1f} s")
    if strategy.reason:  # records of version 0.1 do not say it
        yield Detail(strategy.reason)
    yield from chart_block(view, "candidates")
    names = [row.name for row in models]
    yield Detail(TableBlock(
        "Models", ("model", "terms", "effective", "leave-one-out RMSE [px]"), [
            (label_of(row.name), str(row.n_terms), f"{row.effective:.1f}",
             "-" if row.predicted is None else rounded_size_text(row.predicted)) for row in models],
        marked=names.index(strategy.chosen) if strategy.chosen in names else None))


def _sentences_on_search(record: Record) -> Iterator[Block]:
    """Yield sentences on the size of the selection, its parameters, and the search for it.

    Stability, parameters, a limit of terms and a local refinement have a sentence only where the
    record has them.
    """
    selection = record.selection
    offered = record.offered
    if stability := record.stability:
        yield (f"{selection.n_terms} of {offered.n_terms} terms are in at least "
               f"{stability.threshold:.0%} of {stability.repeats} selections, each with "
               "other control and selection points.")
    yield (f"Selected: {share_in_words(selection.n_features, offered.n_features)} control "
           f"features, {share_in_words(selection.n_terms, offered.n_terms)} terms; "
           f"redundancy {record.adjustment.redundancy}{_iteration_in_words(record.adjustment)}")
    if parameters := selection.parameters:
        yield "Parameters: " + ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in parameters.items())
    # A limit that the user did not ask for may be what kept a term out.
    max_share = _max_share(record)
    if max_share < 1:
        yield f"Limit: {max_share:.2g} terms per equation; --set max_share=1 removes it"
    yield (f"Search: {amount_in_words(record.evaluations, 'evaluation')} ({record.lookups:,} from "
           f"the cache), {count_in_words(record.generations, 'generation')}, {record.seconds:.1f} "
           "s")
    if refinement := record.polish:
        yield (f"Local refinement: {criterion_in_words(record.criterion)} "
               f"{refinement.found:.4g} as {record.solver} found it, "
               f"{refinement.polished:.4g} after it "
               f"({amount_in_words(refinement.evaluations, 'evaluation')})")


def _max_share(record: Record) -> float:
    """Return the largest share of terms by equations that a search may select."""
    return cast("float", record.options.problem.get("max_share", 1.0))


def _proof_of_selection(record: Record) -> Iterator[Block]:
    """Yield the proof of the selection, and how to prove more; nothing without a certificate."""
    if record.certificate:
        exact = "--solver exact"
        if _max_share(record) == 1.0:
            exact += " --set max_share=1"
        if record.solver == "exact":  # it has a front once it has decided all
            exact = "--set recommend=best" if record.front else "a larger budget"
        yield _certificate_sentence(record.certificate, exact)


def _certificate_sentence(certificate: Certificate, exact: str) -> str:
    """Return the statement that a certificate proves; `exact` would find the optimum.

    It is proven, claimed by a solver, or open with the gap that is left: how far the selection may
    be above the optimum, in percent of it. Counts and limits are part of the sentence, since the
    proof holds for selections of that space alone.
    """
    # Such as "all selections of up to 12 terms", whose limit is "up to 12 terms".
    decided = f"{amount_in_words(certificate.subsets, 'subset')} enumerated"
    proven = f"{decided}, {certificate.space}"
    _, _, limit = certificate.space.partition("selections of ")
    capped = f" of {limit}" if limit else ""
    if certificate.claimed_by and certificate.optimal:
        return (f"{certificate.claimed_by} claims that no selection has a better criterion "
                f"({proven}); termsel has not proven it")
    if certificate.optimal:
        how = [decided]
        if certificate.bounded:
            how.append(f"{amount_in_words(certificate.bounded)} of them fathomed by bounds")
        return (f"Proven: no selection{capped} has a better criterion "
                f"({', '.join(how if limit else [*how, certificate.space])})")
    # The optimum is proven, and it is another selection than this one.
    if isinstance(certificate.optimum, float):
        if not isinstance(certificate.gap, float):
            return (f"The proven optimum is {certificate.optimum:.4g}, below this ({proven}); "
                    f"{exact} finds it")
        return (f"Optimality gap: {percent_text(certificate.gap)} above the proven optimum "
                f"{certificate.optimum:.4g} ({proven}); {exact} finds it")
    if certificate.feasible is False:
        return f"Proven: no selection{capped} is feasible ({decided if limit else proven})"
    done = (f"{amount_in_words(certificate.subsets)} of "
            f"{amount_in_words(certificate.of, 'subset')} enumerated")
    if isinstance(certificate.gap, float):
        return (f"Not proven: at most {percent_text(certificate.gap)} above the optimum{capped}, "
                f"which is {certificate.bound:.4g} or more ({done})")
    return f"Not proven: {done}" + (
        "; no lower bound is known yet" if certificate.bound == 0 else "")


def _front_and_proofs(record: Record, view: View | None, picture: str) -> Iterator[Block]:
    """Yield the front, or the best so far of each size, and proofs of their members.

    There are charts, with the `picture` of the image below residuals, if a view is given. Nothing
    is yielded for a record that has neither.
    """
    front = record.front
    by_size = record.by_size
    # The best selections of sizes that beat all smaller sizes form a front, too.
    members: Sequence[Member | SizeRow] = front or [row for row in by_size if row.better]
    if not members:
        return
    if front and view is not None:
        yield from chart_block(view, "front", search.front_chart(view))
        yield Figure("members", "Residuals of the chosen member",
                     "Choose a member in the front or in the table below.",
                     search.member_residuals(view, picture), keeps_ratio=True)
    yield _table_of_members(record, members)
    rule = record.options.problem.get("recommend")
    if rule and (len(record.objectives) > 1 or rule != "best"):
        mark = "arrow" if view is None else "coloured row"
        yield (f"The {mark} marks the selection by the rule {rule}; --set recommend=RULE changes "
               "it.")
    if by_size:
        yield from sizes.sentences_on_sizes(by_size, list(members[0].objectives)[1])
        yield _table_by_size(members, by_size)


def _table_of_members(record: Record, members: Sequence[Member | SizeRow]) -> TableBlock:
    """Return the table of the front, or of the best so far of each size: a row a member.

    Its columns are the objectives, the RMSE at selection points and at independent check points,
    what is proven of the size, and the names of the terms or features. The RMSE at selection points
    is left out if it is an objective, and proofs if nothing is proven of any size. The member with
    the record's own selection is marked.
    """
    size, *further = members[0].objectives
    names = size.removeprefix("n_")
    proofs = {row.objectives[size]: sizes.proven_in_words(row) for row in record.by_size}
    # The heading of each column, and its cells.
    columns = [(sizes.noun_of_members(members),
                [_objective_text(member.objectives[size]) for member in members])]
    for objective in further:
        if objective == "check-rmse":
            columns.append(("selection [px]", [_px_text(member.rmse.check) for member in members]))
        else:
            columns.append((criterion_in_words(objective), [
                _objective_text(member.objectives[objective]) for member in members]))
    # A text has no room for the errors at selection points and for the names.
    page_only = []
    if "check-rmse" not in further:
        page_only.append(len(columns))
        columns.append(("selection [px]", [_px_text(member.rmse.check) for member in members]))
    columns.append(("independent check [px]",
                    [_px_text(member.rmse.independent) for member in members]))
    if proofs:
        columns.append((sizes.TITLE, [proofs.get(member.objectives[size], "")
                                      for member in members]))
    page_only.append(len(columns))
    columns.append((f"selected {names}",
                    [" ".join(getattr(member.selection, names)) for member in members]))
    return TableBlock("Pareto front", tuple(heading for heading, _ in columns),
                      list(zip(*(cells for _, cells in columns), strict=True)),
                      choice="member" if record.front else "",
                      keys=list(range(len(record.front))),
                      marked=sizes.recommended_member(members, record.selection),
                      page_only=tuple(page_only))


def _objective_text(value: float | None) -> str:
    """Return the value of an objective to five digits; "-" where it is not known."""
    return "-" if value is None else f"{value:.5g}"


def _table_by_size(members: Sequence[Member | SizeRow], by_size: Sequence[SizeRow]) -> TableBlock:
    """Return the table of the best selection of each size with its lower bound."""
    size, criterion = list(members[0].objectives)[:2]
    names = size.removeprefix("n_")
    rows = []
    for row in by_size:
        bound = "-" if row.bound is None else f"{row.bound:.4g}"
        rows.append((f"{row.objectives[size]:g}", f"{row.objectives[criterion]:.4g}", bound,
                     sizes.proven_in_words(row), _px_text(row.rmse.independent),
                     " ".join(getattr(row.selection, names))))
    columns = (sizes.noun_of_members(members), criterion_in_words(criterion), "lower bound",
               sizes.TITLE, "independent check [px]", f"selected {names}")
    return TableBlock("Best selection of each size", columns, rows, folded=True)


def _px_text(rmse: RoleRmse) -> str:
    """Return an RMSE [px] as on every screen; "-" where it is not known."""
    return "-" if rmse.total is None else rounded_size_text(rmse.total)


def _sentences_on_coefficients(record: Record) -> Iterator[Block]:
    """Yield which terms are not significant, and how coefficients correlate."""
    weak = [name for name, term in record.significance.items() if term.p > SIGNIFICANT]
    if weak:
        yield Names(f"Not significant ({100 * SIGNIFICANT:.0f} %)", tuple(weak))
    if pairs := record.correlations:
        # Pairs are sorted, the highest correlation first.
        first, second = pairs[0].terms
        yield (f"Correlations of coefficients of {CORRELATED} or more: {len(pairs)}, highest "
               f"{pairs[0].correlation:.4f} ({first}, {second})")
