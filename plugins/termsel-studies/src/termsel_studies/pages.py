"""The tables of a study for people: Markdown and LaTeX."""

from __future__ import annotations

import math
from typing import Any

from termsel import Study, TableBlock
from termsel.toolkit import make_printable
from termsel.toolkit.charts import label_of
from termsel.toolkit.files import markdown_text
from termsel.toolkit.studies import (
    Row,
    count_of_verdicts,
    ground_rmse_text,
    image_name,
    image_table,
    independent_rmse,
    notes_on_image,
    predicted_rmse_text,
    usual_notes,
    usual_notes_in_words,
)
from termsel_studies.claims import valid_claims
from termsel_studies.fronts import front_figures
from termsel_studies.groups import Groups, group
from termsel_studies.significance import compare_methods, effect_size, medians_of
from termsel_studies.summaries import Summary, summarise_runs


def remarks_of(study: Study) -> list[str]:
    """Return sentences on the images together: which stand out, and notes that most have."""
    return [*study.remarks, *usual_notes_in_words(study.rows)]


def tables_of(study: Study, *, brief: bool = False) -> tuple[list[TableBlock], list[str]]:
    """Return the tables of a study, and valid claims.

    Parameters
    ----------
    study : Study
    brief : bool
        Whether tables have at most five columns, as a terminal shows them.
    """
    rows = study.rows
    images = [row for row in rows if row["strategy"] == "auto"]
    tables = [image_table(images) if brief else _image_table(images)]
    if study.spec.strategies == ("auto",):
        return [table for table in tables if table.rows], []
    groups = group(rows, study.records, study.spec.measure)
    # Tests are of medians, one a method and instance.
    comparison = compare_methods(groups.methods, medians_of(groups))
    figures = summarise_runs(groups)
    for name in groups.instances:
        of_instance = [figure for figure in figures if figure.instance == name]
        tables.append((_main_figures if brief else _table_of_instance)(groups, name, of_instance))
    # Fronts are compared where the objectives are the same: on one model, by one criterion.
    searched = group([row for row in rows if row["strategy"] != "auto"], study.records, "fitness")
    tables.append(TableBlock(
        "Fronts", ("instance", "method", "hypervolume", "IGD+", "reference"),
        [(figure.instance, figure.method, f"{figure.hypervolume:.4f}", f"{figure.igd_plus:.4f}",
          figure.reference) for figure in front_figures(searched)]))
    if comparison is not None:
        title = f"Over {comparison.instances} instances"
        if comparison.difference is not None:
            title += f": critical difference of mean ranks {comparison.difference:.2f} (Nemenyi)"
        tables.append(TableBlock(title, ("method", "mean rank"), sorted(
            ((name, f"{rank:.2f}") for name, rank in zip(comparison.methods, comparison.ranks,
                                                         strict=True)),
            key=lambda row: float(row[1]))))
        tables.append(TableBlock(
            "Pairs", ("method", "compared with", "better on", "worse on", "p (Wilcoxon)",
                      "p (Holm)"),
            [(pair.first, pair.second, str(pair.wins), str(pair.losses), f"{pair.p:.2g}",
              f"{pair.corrected:.2g}") for pair in comparison.pairs]))
    # What failed is named with its reason: it counts as worst above.
    tables.append(TableBlock("Runs without a result", ("run", "state", "reason"),
                             _rows_without_result(rows)))
    return [table for table in tables if table.rows], valid_claims(groups, comparison, rows)


def _image_table(rows: list[Row]) -> TableBlock:
    """Return a table with a row for each image; columns that are empty for all are left out."""
    usual = usual_notes(rows)
    header = ("image", "verdict", "reason", "model", "RMSE [px]", "RMSE [m]", "ICP RMSE [px]",
              "blunders", "without height", "place", "notes")
    lines = []
    for row in rows:
        model = label_of(row["chosen"]) if row["chosen"] else row["state"]
        lines.append((image_name(row), row["verdict"] or row["state"], row["why"] or "",
                      model, predicted_rmse_text(row), ground_rmse_text(row),
                      independent_rmse(row),
                      ", ".join(row["blunders"] or ()),
                      str(row["without_height"] or ""), row["place"] or "",
                      notes_on_image(row, usual)))
    # A column that is empty for all images would only make the others narrow.
    shown = [i for i in range(len(header)) if any(line[i] for line in lines)]
    return TableBlock(count_of_verdicts(rows), tuple(header[i] for i in shown),
                      [tuple(line[i] for i in shown) for line in lines],
                      keys=[row["cell"] for row in rows])


def _table_of_instance(groups: Groups, name: str, figures: list[Summary]) -> TableBlock:
    """Return the figures of all methods on an instance; effect sizes are those of the best one.

    Quartiles are of the measure that the study compares by. Columns on the optimum are there where
    one is proven, and that of independent check points where the measure is another. The effect
    size is the chance that the best method beats the one in the row.
    """
    optimum = figures[0].optimum
    shows_independent = groups.measure != "independent"  # else the quartiles are theirs
    header = ["method", "runs", "best", "lower quartile", "median", "upper quartile", "worst",
              "effect size"]
    if optimum is not None:
        header += ["optimum reached", "95 % interval", "expected evaluations"]
    if shows_independent:
        header.append("ICP RMSE [px]")
    header += ["evaluations", "CPU s"]
    runs_of = groups.instances[name]
    best = min(figures, key=lambda figure: figure.quartiles[2]).method
    rows = []
    for figure in figures:
        if figure.finished == figure.runs:
            runs = str(figure.runs)
        else:
            runs = f"{figure.finished} of {figure.runs}"
        if figure.method == best:
            effect = ""
        else:
            effect = f"{effect_size(runs_of[best].values, runs_of[figure.method].values):.2f}"
        row = [figure.method, runs, *(format_number(value, 4) for value in figure.quartiles),
               effect]
        if optimum is not None:
            low, high = figure.interval
            row += [f"{figure.reached} of {figure.runs}", f"{100 * low:.0f} to {100 * high:.0f} %",
                    format_number(figure.expected, 0)]
        if shows_independent:
            row.append(format_number(figure.independent, 3))
        rows.append((*row, format_number(figure.evaluations, 0),
                     format_number(figure.cpu_seconds, 2)))
    return TableBlock(_title_of_study(name, optimum), tuple(header), rows)


def _main_figures(groups: Groups, name: str, figures: list[Summary]) -> TableBlock:
    """Return the main figures of all methods on an instance, in at most five columns."""
    optimum = figures[0].optimum
    header = ["method", "median [quartiles]"]
    header += ["optimum reached", "expected evaluations"] if optimum is not None else ["runs"]
    header += [] if groups.measure == "independent" else ["ICP RMSE [px]"]
    rows = []
    for figure in figures:
        _, low, median, high, _ = (format_number(value, 3) for value in figure.quartiles)
        row = [figure.method, f"{median} [{low}-{high}]"]
        if optimum is not None:
            row += [f"{figure.reached} of {figure.runs}", format_number(figure.expected, 0)]
        else:
            row += [str(figure.finished)]
        row += [] if groups.measure == "independent" else [format_number(figure.independent, 3)]
        rows.append(tuple(row))
    return TableBlock(_title_of_study(name, optimum), tuple(header), rows)


def _title_of_study(name: str, optimum: float | None) -> str:
    """Return the title of a table, with the optimum if it is proven."""
    return name if optimum is None else f"{name}: proven optimum {optimum:.4f}"


def _rows_without_result(rows: list[Row]) -> list[tuple[str, str, str]]:
    """Return run, state and reason of what failed; seeds of one reason are together."""
    seeds_by_run: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row["state"] in ("failed", "infeasible"):
            run = (_row_in_words(row), row["state"], row["reason"])
            seeds_by_run.setdefault(run, []).append(str(row["seed"]))
    return [(f"{run}, seed {_seeds_in_words(seeds)}", state, reason)
            for (run, state, reason), seeds in seeds_by_run.items()]


def _seeds_in_words(seeds: list[str]) -> str:
    """Return seeds, of many the first and how many more there are."""
    more = len(seeds) - _MOST_SEEDS
    return ", ".join(seeds[:_MOST_SEEDS]) + (f" and {more} more" if more > 0 else "")


_MOST_SEEDS = 5
"""Seeds of one reason that are named."""


def _row_in_words(row: Row) -> str:
    """Return the name of a row: problem, data, model and solver, as far as it has them."""
    return ", ".join(str(row[name]) for name in ("problem", "data", "model", "solver")
                     if row[name] not in ("", None))


def format_number(value: float | None, digits: int) -> str:
    """Return a number for a table; blank if there is none, and a sign for infinity."""
    if value is None:
        return ""
    return f"{value:.{digits}f}" if math.isfinite(value) else "∞"


def title_of(study: Study) -> str:
    """Return the title of a study, or what it is of."""
    of_images = study.spec.strategies == ("auto",)
    return study.spec.title or ("Batch of images" if of_images else "Study")


def study_as_markdown(study: Study) -> str:
    """Return all tables of a study, and its valid claims, as Markdown."""
    tables, sentences = tables_of(study)
    remarks = [f"- {markdown_text(remark)}" for remark in remarks_of(study)]
    paragraphs = [f"# {markdown_text(title_of(study))}\n"]
    if remarks:
        paragraphs.append("\n".join(remarks) + "\n")
    paragraphs += map(table_as_markdown, tables)
    if sentences:
        paragraphs.append("## What may be claimed\n")
        paragraphs.append("\n".join(f"- {markdown_text(sentence)}" for sentence in sentences)
                          + "\n")
    return "\n".join(paragraphs)


def table_as_markdown(table: TableBlock, depth: int = 2) -> str:
    """Return a table with its heading as Markdown."""
    # Numbers to the right, all else to the left; the first column is names.
    marks = ["---", *("---:" if _is_numeric(table, i) else "---"
                      for i in range(1, len(table.columns)))]
    lines = ["| " + " | ".join(map(markdown_text, row)) + " |"
             for row in (table.columns, *table.rows)]
    return "\n".join([f"{'#' * depth} {markdown_text(table.caption)}\n", lines[0],
                      f"|{'|'.join(marks)}|", *lines[1:], ""])


def _is_numeric(table: TableBlock, column: int) -> bool:
    """Return whether all filled cells of a column are numbers."""
    cells = [row[column] for row in table.rows if row[column]]
    return all(cell[0].isdigit() or cell[0] in "-∞" for cell in cells)


_LATEX = {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
          "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
          "∞": r"$\infty$"}


def study_as_latex(study: Study) -> str:
    """Return all tables of a study as LaTeX, for the package booktabs."""
    environments = []
    for table in tables_of(study)[0]:
        columns = "".join("r" if i and _is_numeric(table, i) else "l"
                          for i in range(len(table.columns)))
        lines = [" & ".join(map(_escape_latex, row)) + r" \\"
                 for row in (table.columns, *table.rows)]
        environments.append("\n".join([
            r"\begin{table}", rf"\caption{{{_escape_latex(table.caption)}}}",
            rf"\begin{{tabular}}{{{columns}}}", r"\toprule", lines[0], r"\midrule", *lines[1:],
            r"\bottomrule", r"\end{tabular}", r"\end{table}", ""]))
    return "\n".join(environments)


def _escape_latex(text: Any) -> str:
    """Return a text for LaTeX: commands escaped, white space as one blank."""
    words = make_printable(" ".join(str(text).split()))
    # Signs that LaTeX takes for commands; all white space is one blank.
    return "".join(_LATEX.get(sign, sign) for sign in words)
