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
    """Return sentences on all images together: which stand out, and notes that most of them have.
    """
    return [*study.remarks, *usual_notes_in_words(study.rows)]


def tables_of(study: Study, *, brief: bool = False) -> tuple[list[TableBlock], list[str]]:
    """Return the tables of a study that have rows, and sentences on what may be claimed.

    A study of images alone has one table, and no claims. Others have a table for each instance;
    the tests over instances, where there are enough; fronts; and runs without a result.

    Parameters
    ----------
    study : Study
        As `termsel.compare` returns it.
    brief : bool
        Whether tables have at most five columns, as a terminal shows them.
    """
    rows = study.rows
    images = [row for row in rows if row["strategy"] == "auto"]
    tables = [image_table(images) if brief else _image_table(images)]
    if study.spec.strategies == ("auto",):
        return [table for table in tables if table.rows], []
    groups = group(rows, study.records, study.spec.measure)
    # The tests compare medians: one value for each method and instance.
    comparison = compare_methods(groups.methods, medians_of(groups))
    figures = summarise_runs(groups)
    for name in groups.instances:
        of_instance = [figure for figure in figures if figure.instance == name]
        table_of = _brief_table_of_instance if brief else _table_of_instance
        tables.append(table_of(groups, name, of_instance))
    # Fronts have the same objectives within one model and criterion, as groups by fitness do.
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
    # Runs that failed count as the worst in the tables above, so the reason is shown.
    tables.append(TableBlock("Runs without a result", ("run", "state", "reason"),
                             _rows_without_result(rows)))
    return [table for table in tables if table.rows], valid_claims(groups, comparison, rows)


def _image_table(rows: list[Row]) -> TableBlock:
    """Return the table of images, a row each, without columns that are empty for all.

    Its keys are those of the cells, by which pictures of the images are found.
    """
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
    # Columns that are blank in every row would only make the table wide.
    shown = [i for i in range(len(header)) if any(line[i] for line in lines)]
    return TableBlock(count_of_verdicts(rows), tuple(header[i] for i in shown),
                      [tuple(line[i] for i in shown) for line in lines],
                      keys=[row["cell"] for row in rows])


def _table_of_instance(groups: Groups, name: str, figures: list[Summary]) -> TableBlock:
    """Return the table of an instance with a row for each method.

    Quartiles are of the measure that the study compares by. The effect size is the chance that a
    run of the best method, that with the lowest median, beats one of the method in the row; blank
    for the best itself. There are columns on the optimum if one is proven, and one of independent
    check points if the study compares by another measure.
    """
    optimum = figures[0].optimum
    # A study that compares by independent points has them in its quartiles.
    shows_independent = groups.measure != "independent"
    header = ["method", "runs", "best", "lower quartile", "median", "upper quartile", "worst",
              "effect size"]
    if optimum is not None:
        header += ["optimum reached", "95 % interval", "expected evaluations"]
    if shows_independent:
        header.append("ICP RMSE [px]")
    header += ["evaluations", "CPU s"]
    runs_of = groups.instances[name]
    # Entry 2 is the median: quartiles are the least, the lower, the median, the upper, the largest.
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
    return TableBlock(_title_of_instance(name, optimum), tuple(header), rows)


def _brief_table_of_instance(groups: Groups, name: str, figures: list[Summary]) -> TableBlock:
    """Return the table of an instance with a row for each method, in at most five columns.

    With a proven optimum, how often and how soon it was reached takes the place of the number of
    finished runs.
    """
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
    return TableBlock(_title_of_instance(name, optimum), tuple(header), rows)


def _title_of_instance(name: str, optimum: float | None) -> str:
    """Return the title of the table of an instance, with the optimum if it is proven."""
    return name if optimum is None else f"{name}: proven optimum {optimum:.4f}"


def _rows_without_result(rows: list[Row]) -> list[tuple[str, str, str]]:
    """Return run, state and reason of each run that failed or is infeasible.

    Runs that differ in the seed alone, and failed for one reason, share a row.
    """
    seeds_by_run: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row["state"] in ("failed", "infeasible"):
            run = (_row_in_words(row), row["state"], row["reason"])
            seeds_by_run.setdefault(run, []).append(str(row["seed"]))
    return [(f"{run}, seed {_seeds_in_words(seeds)}", state, reason)
            for (run, state, reason), seeds in seeds_by_run.items()]


def _seeds_in_words(seeds: list[str]) -> str:
    """Return seeds with commas between them: the first five, and how many more there are."""
    more = len(seeds) - _MAX_SEEDS
    return ", ".join(seeds[:_MAX_SEEDS]) + (f" and {more} more" if more > 0 else "")


_MAX_SEEDS = 5
"""How many seeds are listed of runs that failed for one reason."""


def _row_in_words(row: Row) -> str:
    """Return problem, data, model and solver of a row with commas between, without blank ones."""
    return ", ".join(str(row[name]) for name in ("problem", "data", "model", "solver")
                     if row[name] not in ("", None))


def format_number(value: float | None, digits: int) -> str:
    """Return a number for a table, with so many decimals: "" for None, "∞" if it is not finite."""
    if value is None:
        return ""
    return f"{value:.{digits}f}" if math.isfinite(value) else "∞"


def title_of(study: Study) -> str:
    """Return the title of a study; without one "Batch of images" or "Study"."""
    of_images = study.spec.strategies == ("auto",)
    return study.spec.title or ("Batch of images" if of_images else "Study")


def study_as_markdown(study: Study) -> str:
    """Return the page of a study as Markdown: title, remarks, tables, and valid claims.

    Parts without content are left out.
    """
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
    # Columns of numbers are aligned to the right. The first column has names, though they may look
    # like numbers.
    marks = ["---", *("---:" if _is_numeric(table, i) else "---"
                      for i in range(1, len(table.columns)))]
    lines = ["| " + " | ".join(map(markdown_text, row)) + " |"
             for row in (table.columns, *table.rows)]
    return "\n".join([f"{'#' * depth} {markdown_text(table.caption)}\n", lines[0],
                      f"|{'|'.join(marks)}|", *lines[1:], ""])


def _is_numeric(table: TableBlock, column: int) -> bool:
    """Return whether all filled cells of a column begin like a number; True if none is filled."""
    cells = [row[column] for row in table.rows if row[column]]
    return all(cell[0].isdigit() or cell[0] in "-∞" for cell in cells)


_LATEX = {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
          "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
          "∞": r"$\infty$"}


def study_as_latex(study: Study) -> str:
    """Return all tables of a study as LaTeX: table environments, with rules of booktabs.

    Columns of numbers are aligned to the right.
    """
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
    """Return a text for LaTeX: signs that it takes for commands escaped, white space as one blank.
    """
    words = make_printable(" ".join(str(text).split()))
    return "".join(_LATEX.get(sign, sign) for sign in words)
