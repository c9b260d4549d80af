"""The command of this package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from termsel import Result
    from termsel_standards.statement import PredictedStatement, Statements

SIGNATURE = "Date:                Signed:"
"""The last line of a statement, which people print and sign."""

_PATH = click.Path(path_type=Path)
_POSITIVE_METRES = click.FloatRange(0, 1e6, min_open=True)


@click.command("accuracy")
@click.argument("source", metavar="DIR|TABLE", type=_PATH)
@click.option("--survey-sigma", metavar="METRES", type=_POSITIVE_METRES,
              help="Standard deviation of each surveyed horizontal coordinate of the check points, "
                   "if they have no columns sigma_x and sigma_y.")
@click.option("--survey-sigma-z", metavar="METRES", type=_POSITIVE_METRES,
              help="Standard deviation of their heights, if they have no column sigma_z.")
@click.option("--class", "horizontal", metavar="METRES", type=_POSITIVE_METRES,
              help="Horizontal accuracy class that the data were to meet.")
@click.option("--class-z", "vertical", metavar="METRES", type=_POSITIVE_METRES,
              help="Vertical accuracy class that the data were to meet.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON alone on stdout.")
def accuracy(source: Path, survey_sigma: float | None, survey_sigma_z: float | None,
             horizontal: float | None, vertical: float | None, as_json: bool) -> None:
    """State the accuracy by ASPRS (edition 2, 2024) and NSSDA.

    DIR is the folder that a run wrote with --out; its independent points are the check points.
    Without such points, and with fewer than the standards take, the accuracy that the run predicted
    is stated, with its interval and how it was found: it is no test, so the standards have no
    statement on it. Of a folder of several results, such as a block or a batch wrote, each is
    stated.
    TABLE is a CSV of errors in metres, headed id,dx,dy and where they are known
    dz,x,y,sigma_x,sigma_y,sigma_z.

    \b
    Examples:
      termsel accuracy result
      termsel accuracy result --survey-sigma 0.05 --class 1
      termsel accuracy errors.csv --json
    """
    import msgspec

    from termsel_standards.errors import errors_of, read_errors
    from termsel_standards.statement import statements_of

    stated: list[Statements | PredictedStatement]
    # A file is a table of errors, unless it is the result.json of a folder.
    is_one = True
    if source.is_file() and source.suffix != ".json":
        errors = read_errors(source)
        surveyed = errors.surveyed(survey_sigma, survey_sigma_z)
        stated = [statements_of(surveyed, horizontal, vertical)]
        took = "which must have taken"
    else:
        took = "which took"

        def state(result: Result) -> Statements | PredictedStatement:
            """Return the statement on what a result predicts, or on its independent points."""
            return _predicted_statement(result) or _with_prediction(statements_of(
                errors_of(result).surveyed(survey_sigma, survey_sigma_z), horizontal, vertical),
                result)

        results = _read_results(source)
        is_one = len(results) == 1
        stated = _statements_on_results(results, state)
    if as_json:
        content = stated[0] if is_one else stated
        click.echo(msgspec.json.format(msgspec.json.encode(content), indent=2))
        return
    click.echo("\n\n\n".join("\n".join(_statement_lines(statement, took)) for statement in stated))


def _statements_on_results(results: list[Result],
                           state: Callable[[Result], Statements | PredictedStatement],
                           ) -> list[Statements | PredictedStatement]:
    """Return the statements that `state` makes on results, in their order.

    Of several results, those it raises TermselError for are left out, and named on stderr with the
    reason. Raises TermselError if no result has a statement.
    """
    from termsel import TermselError

    stated = []
    for result in results:
        # The error of a single result is that of the command.
        try:
            stated.append(state(result))
        except TermselError as error:
            if len(results) == 1:
                raise
            click.echo(f"{result.data.source}: not stated: {error.what}.", err=True)
    if not stated:
        raise TermselError("the accuracy of none of these results can be estimated",
                           hint="Measure further points and give them the role independent.")
    return stated


def _read_results(folder: Path) -> list[Result]:
    """Return the result of a folder, or the results within it, as blocks and batches have them.

    A warning is printed for each result whose notes doubt the RPC that it corrects. Raises
    TermselError if there is no result, or one cannot be read.
    """
    from termsel import read_result
    from termsel.toolkit.files import results_within
    from termsel.toolkit.runs import RPC_DOUBTS

    inner = [] if (folder / "result.json").exists() else results_within(folder)
    results = [read_result(result) for result in inner] or [read_result(folder)]
    # People sign the statement, so they are told what makes its figures too good.
    for result in results:
        for note in result.notes:
            if note.startswith(RPC_DOUBTS):
                click.echo(f"Warning: {result.data.source}: {note}", err=True)
    return results


def _predicted_statement(result: Result) -> PredictedStatement | None:
    """Return the statement on the accuracy that a result predicts.

    None if independent points tested it, or if it predicts none.
    """
    from termsel.toolkit.files import prediction_of
    from termsel_standards.statement import prediction_statement

    prediction = prediction_of(result) if result.accuracy is None else None
    return None if prediction is None else prediction_statement(result.data.source, prediction)


def _with_prediction(stated: Statements, result: Result) -> Statements:
    """Return tested statements, with what the run predicts if the check points are too few.

    They are too few below `MIN_REDUCED`, where no standard has a statement. A run that predicts
    nothing adds nothing.
    """
    from termsel.toolkit.files import prediction_of
    from termsel_standards.statement import MIN_REDUCED

    # A result without check points has its prediction to sign; one with a few has it too.
    prediction = prediction_of(result) if stated.distribution.points < MIN_REDUCED else None
    return stated if prediction is None else replace(stated, prediction=prediction.sentence)


def _statement_lines(stated: Statements | PredictedStatement, took: str) -> Iterator[str]:
    """Return the lines of a statement for the terminal, tested or predicted.

    `took` is the verb for the check points of a tested one, "which took" or "which must have
    taken": termsel cannot know how the points of a table were used.
    """
    from termsel_standards.statement import Statements
    if isinstance(stated, Statements):
        return _tested_lines(stated, took)
    return _predicted_lines(stated)


_TWO_FIGURES = ("CE95 and NSSDA's figure differ: 95 % of the errors found are below CE95; NSSDA "
                "takes 2.4477 times the mean RMSE of east and north, as of normal errors.")
"""The note that says why there are two figures at 95 %."""


def _tested_lines(stated: Statements, took: str) -> Iterator[str]:
    """Yield the lines of a tested statement: points, figures, statements of standards, notes.

    `took` is as for `_statement_lines`.
    """
    from termsel.toolkit import count_in_words

    # Four blocks with a blank line between: what was tested, the errors by direction, the figures
    # of them together with the distribution of the points, and what the standards let one say.
    points = stated.distribution.points
    yield (f"{stated.source}: {count_in_words(points, 'independent check point')}, {took} no part "
           "in any choice")
    yield ""
    yield f"{'':8}{'mean':>10}{'std':>10}{'RMSE':>10}{'95 %':>10}{'largest':>10}  normality"
    for component in stated.components:
        normal = "-" if component.normal is None else f"p {component.normal:.2g}"
        yield (f"{component.name:8}{component.mean:10.3f}{_figure_text(component.deviation)}"
               f"{component.rmse:10.3f}{component.percentile95:10.3f}{component.maximum:10.3f}  "
               f"{normal}")
    yield ""
    yield (f"Horizontal RMSE {stated.horizontal:.3f} m, CE90 {stated.ce90:.3f} m, "
           f"CE95 {stated.ce95:.3f} m{_survey_text(stated.survey_horizontal)}")
    if stated.vertical is not None:
        yield (f"Vertical RMSE {stated.vertical:.3f} m, LE90 {stated.le90:.3f} m"
               f"{_survey_text(stated.survey_vertical)}")
        yield f"Three-dimensional RMSE {stated.three_dimensional:.3f} m"
    distribution = stated.distribution
    area = "" if distribution.area is None else f" for {distribution.area:.3g} km2"
    yield f"Check points: {points}; ASPRS asks for {distribution.required}{area}." + (
        "" if distribution.quadrants is None else
        f" In the quadrants SW, SE, NW, NE: {', '.join(map(str, distribution.quadrants))}.")
    yield ""
    for statement in stated.statements:
        yield fill(f"{statement.standard}: {statement.words}.", 90, subsequent_indent="    ")
    if any(statement.standard == "NSSDA horizontal" and statement.value is not None
           for statement in stated.statements):
        yield fill(f"Note: {_TWO_FIGURES}", 90, subsequent_indent="    ")
    yield from (fill(f"Note: {note}", 90, subsequent_indent="    ") for note in stated.notes)
    if stated.prediction is not None:
        yield ""
        yield fill(f"{stated.prediction}.", 90)
    yield ""
    yield _figure_to_sign(stated)
    yield SIGNATURE


def _predicted_lines(stated: PredictedStatement) -> Iterator[str]:
    """Yield the lines of a predicted accuracy, the last of them for date and signature."""
    yield f"{stated.source}: no independent check points"
    yield ""
    yield fill(f"{stated.words}.", 90)
    yield ""
    for statement in stated.statements:
        yield fill(f"{statement.standard}: {statement.words}.", 90, subsequent_indent="    ")
    yield ""
    yield "To sign: the predicted RMSE above, as predicted and not tested."
    yield SIGNATURE


def _figure_to_sign(stated: Statements) -> str:
    """Return the sentence that says which of the figures of a tested statement is to be signed.

    It is those of the standards that have a statement, else the predicted RMSE, or none of them.
    """
    from termsel.toolkit import count_in_words

    # ASPRS and NSSDA have statements by direction, and each standard is named once.
    standards = dict.fromkeys(statement.standard.split()[0] for statement in stated.statements
                              if not statement.words.startswith("not stated"))
    if standards:
        return f"To sign: the tested figures of {' and '.join(standards)} above."
    points = stated.distribution.points
    few = "is" if points == 1 else "are"
    too_few = f"{count_in_words(points, 'check point')} {few} too few for a test"
    if stated.prediction is not None:
        return f"To sign: the predicted RMSE above, as predicted: {too_few}."
    return f"To sign: none of these figures, as {too_few}."


def _figure_text(value: float | None) -> str:
    """Return a figure [m] to a millimetre in ten characters, aligned to the right; "-" for None."""
    return f"{'-':>10}" if value is None else f"{value:10.3f}"


def _survey_text(value: float | None) -> str:
    """Return the clause on the RMSE of the survey [m], which says so if it is None: not known."""
    return "; the error of the survey is not known" if value is None else f"; survey {value:.3f} m"
