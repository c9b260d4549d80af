"""Accuracy of the strategy auto on unseen points, and of its own prediction, by two studies.

``python -m benchmarks.accuracy`` draws files of points (see `benchmarks.sets`), runs
benchmarks/honest-accuracy.toml and benchmarks/honest-accuracy-ga.toml on them as `termsel compare`
does, and prints the tables. ``--write`` makes docs/evidence/honest-accuracy.md of them. With
``--out DIR`` files and studies are kept, and the same command goes on where an earlier one stopped.
``--splits N`` makes it shorter, names of sets and ``--counts`` choose among them.

What no study can tell is computed here: poles at the independent check points, from the results
that the study keeps, and what other constants of the program would give.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import termsel
from benchmarks.sets import NOISE, PLAIN, crs_of, heights_of, names, put, rmse_of, split
from termsel.adjustment.bayesian import posterior
from termsel.auto import rule
from termsel.auto.auto import Auto
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.simulate.catalogue import SCENES
from termsel.studies.cells.images import IMAGES, folders_of

HERE = Path(__file__).parent
STUDIES = ("honest-accuracy", "honest-accuracy-ga")
COUNTS = (12, 20, 40, 74, 150)
FEW = (12, 20)
GA_COUNTS, GA_SPLITS = (20, 40, 74), 1
BAD = 1.5
"""Ratio to the best conventional model of a split above which auto was much worse."""
FEWEST = 30
"""Independent points below which a split is left out."""


@dataclass(frozen=True)
class Split:
    """One split: independent RMSE of auto and conventional models, and RMSE that auto predicts."""

    auto: float
    predicted: float
    plain: dict[str, float]
    pole: bool
    seconds: float


@dataclass(frozen=True)
class Row:
    """All splits of one set and one number of points."""

    name: str
    count: int
    splits: tuple[Split, ...]

    @property
    def best(self) -> tuple[str, float]:
        """The conventional model with the least median, chosen with hindsight."""
        medians = {name: median(s.plain.get(name, float("inf")) for s in self.splits)
                   for name in dict.fromkeys(name for s in self.splits for name in s.plain)}
        best = min(medians, key=lambda name: medians[name])
        return best, medians[best]

    @property
    def ratio(self) -> float:
        """Ratio of the median of auto to that of the best conventional model."""
        return median(s.auto for s in self.splits) / self.best[1]

    @property
    def worst(self) -> float:
        """Greatest ratio to the best conventional model of the split."""
        return max(s.auto / min(s.plain.values()) for s in self.splits)

    @property
    def honesty(self) -> float:
        """Median of independent divided by predicted RMSE."""
        return median(s.auto / s.predicted for s in self.splits)


def draw(folder: Path, wanted: list[str], counts: list[int], splits: int) -> None:
    """Write the points of all splits, a file each; those for the papers' GA into a folder apart."""
    for kind in ("points", "halves"):
        (folder / kind).mkdir(exist_ok=True)
    for name in wanted:
        for count in counts:
            for seed in range(splits):
                mine, independent = split(name, count, seed)
                if len(independent) < FEWEST:
                    continue
                file, ids = f"{name}-{count}-{seed}.csv", mine.ids + independent.ids
                both = Points(ids, np.concatenate([mine.image, independent.image]),
                              np.concatenate([mine.ground, independent.ground]), None)
                rest = ("independent",) * len(independent)
                write_points_csv(replace(both, roles=("control",) * count + rest),
                                 folder / "points" / file, crs=crs_of(name))
                if count in GA_COUNTS and seed < GA_SPLITS:
                    half = (("control", "check") * count)[:count]
                    write_points_csv(replace(both, roles=half + rest),
                                     folder / "halves" / file, crs=crs_of(name))


def studied(folder: Path, name: str, workers: int) -> termsel.Study:
    """Return a study of the files of a folder, as `termsel compare` makes it."""
    shutil.copy(HERE / f"{name}.toml", folder)

    def tell(progress: Any) -> None:
        if progress.finished % 50 == 0:
            sys.stderr.write(f"{name}: {progress.finished} of {progress.total}, "
                             f"{progress.time_left()}\n")

    return termsel.compare(folder / f"{name}.toml", out=folder / name, workers=workers,
                           observers=(tell,))


def parts_of(label: str) -> tuple[str, int, int]:
    """Return set, number of points and split of a file that `draw` wrote."""
    name, count, seed = Path(label).stem.rsplit("-", 2)
    return name, int(count), int(seed)


def rows_of(study: termsel.Study) -> Iterator[Row]:
    """Yield the splits of every set and number of points."""
    assert study.folder is not None
    by_file: dict[str, list[dict[str, Any]]] = {}
    for row in study.rows:
        by_file.setdefault(row["data"], []).append(row)
    folders = folders_of(study.cells)
    found: dict[tuple[str, int], list[Split]] = {}
    for label, cells in sorted(by_file.items(), key=lambda one: parts_of(one[0])):
        name, count, _ = parts_of(label)
        auto = next(row for row in cells if row["strategy"] == "auto")
        # A structure that termsel itself refuses, for a pole or too few points, counts as it is.
        plain = {row["model"]: row["independent"] for row in cells
                 if row["strategy"] != "auto" and row["independent"] is not None}
        found.setdefault((name, count), []).append(Split(
            _or_infinite(auto["independent"]), _or_infinite(auto["predicted"]), plain,
            auto["state"] == "done" and has_pole(study.folder / IMAGES / folders[auto["cell"]]),
            auto["cpu_seconds"] or 0.0))
    yield from (Row(name, count, tuple(splits)) for (name, count), splits in found.items())


def _or_infinite(value: float | None) -> float:
    return float("inf") if value is None else value


def has_pole(folder: Path) -> bool:
    """Return whether a denominator of a result is not positive at an independent point."""
    result = termsel.read_result(folder)
    fit, points = result.fit, result.features.points
    ground = points.ground[[role == "independent" for role in points.roles]]
    below = fit.model.denominators(fit.adjustment.coefficients, fit.scaling.ground(ground))
    return below is not None and bool((below <= 0).any())


def table(found: list[Row]) -> str:
    """Return the figures of every set and number of points."""
    return "\n".join([
        "| set | points | best plain | px | auto px | ratio | worst split | "
        "independent / predicted | CPU s |", "|---|---:|---|---:|---:|---:|---:|---:|---:|",
        *map(line, found)])


def line(row: Row) -> str:
    """Return a row of the table."""
    name, value = row.best
    return (f"| {row.name} | {row.count} | {name} | {value:.2f} | "
            f"{median(s.auto for s in row.splits):.2f} | {row.ratio:.2f} | {row.worst:.2f} | "
            f"{row.honesty:.2f} | {median(s.seconds for s in row.splits):.1f} |")


def verdict(found: list[Row]) -> str:
    """Return what was required next to what was measured."""
    few = [row.ratio for row in found if row.count in FEW]
    over = [row for row in found if row.ratio > 1.05]
    all_splits = [(row, s) for row in found for s in row.splits]
    bad = sum(s.auto > BAD * min(s.plain.values()) for _, s in all_splits)
    floors = [median(s.auto for s in row.splits) / (NOISE * np.sqrt(2 * (1 + 10 / row.count)))
              for row in found if row.name in SCENES and row.count >= 74]
    honest = median(s.auto / s.predicted for _, s in all_splits)
    named = ", ".join(f"{row.name} at {row.count} ({row.ratio:.2f})" for row in over) or "none"
    lines = [
        "| what | required | measured |", "|---|---|---|",
        f"| ratio to the best conventional model in hindsight, median over sets | at most 1.00 | "
        f"{median(row.ratio for row in found):.2f} |",
        f"| the same at {' and '.join(map(str, FEW))} points | at most 0.95 | "
        f"{f'{median(few):.2f}' if few else '-'} |",
        f"| the same on every set | at most 1.05 | above it: {named} |",
        f"| splits with a pole | 0 | {sum(s.pole for _, s in all_splits)} of {len(all_splits)} |",
        f"| splits worse than {BAD} times the best conventional model of that split | 0 | "
        f"{bad} of {len(all_splits)}; worst {max(row.worst for row in found):.2f} |",
        "| scenes at 74 points and more: ratio to noise sqrt(1 + 10/n), worst | at most 1.10 | "
        f"{f'{max(floors):.2f}' if floors else '-'} |",
        "| independent divided by predicted RMSE, median over splits | 0.90 to 1.15 | "
        f"{honest:.2f} |",
        "| CPU seconds, 74 points, median | less than 10 | "
        f"{_seconds(found)} |"]
    return "\n".join(lines)


def missed(found: list[Row]) -> str:
    """Return with how many points the requirement on single splits is missed."""
    counts = sorted({row.count for row in found if row.worst > BAD})
    if not counts:
        return "No split is worse than that."
    return f"Splits worse than that have {' or '.join(map(str, counts))} points."


def rules(found: list[Row]) -> str:
    """Return how often auto and each conventional model are much worse than the best one."""
    few = [s for row in found if row.count in FEW for s in row.splits]
    oracle = [s.plain.get(row.best[0], float("inf")) for row in found if row.count in FEW
              for s in row.splits]
    lines = [f"| rule | splits worse than {BAD} times the best of the split, at "
             f"{' and '.join(map(str, FEW))} points | worst |", "|---|---:|---:|"]
    for name, errors in (("auto", [s.auto for s in few]), *(
            (name, [_of_kind(s, name) for s in few])
            for name in ("affine", "quadratic", "cubic")),
            ("the best of the set in hindsight", oracle)):
        ratios = [error / min(s.plain.values()) for error, s in zip(errors, few, strict=True)]
        worst = f"{max(ratios):.1f}" if max(ratios) < float("inf") else "not determined"
        lines.append(f"| {name} | {sum(r > BAD for r in ratios)} of {len(ratios)} | {worst} |")
    return "\n".join(lines)


def _of_kind(one: Split, name: str) -> float:
    """Return the RMSE of a structure in space, or in the plane where there are no heights."""
    kind = "space" if "affine, space" in one.plain else "plane"
    return one.plain.get(f"{name}, {kind}", float("inf"))


def _seconds(found: list[Row]) -> str:
    seconds = [s.seconds for row in found if row.count == 74 for s in row.splits]
    return f"{median(seconds):.1f}" if seconds else "-"


def against_papers(study: termsel.Study) -> str:
    """Return the comparison with the papers' GA."""
    ratios: dict[str, list[float]] = {}
    for label in dict.fromkeys(row["data"] for row in study.rows):
        by_strategy = {row["strategy"]: _or_infinite(row["independent"]) for row in study.rows
                       if row["data"] == label}
        ratios.setdefault(parts_of(label)[0], []).append(
            by_strategy["auto"] / by_strategy["as-asked"])
    medians = {name: median(several) for name, several in ratios.items()}
    lines = ["| set | independent RMSE of auto divided by that of the GA, median |", "|---|---:|"]
    lines += [f"| {name} | {ratio:.2f} |" for name, ratio in medians.items()]
    return "\n".join([*lines, f"| median over sets (required: at most 0.75) | "
                              f"{median(medians.values()):.2f} |"])


CONSTANTS = (
    *((posterior, name) for name in ("PRIOR_SIZES", "TYPICAL_SIZE", "FALLS", "RELIEFS",
                                     "DRAW_DEVIATION", "N_DRAWS")),
    *((rule, name) for name in ("PRIOR_MARGIN", "CLEAR_MARGIN")))


def sensitivity(wanted: list[str], splits: int) -> str:
    """Return the ratio to the best conventional model with each constant halved and doubled."""
    jobs = [(name, count, seed) for name in wanted for count in (12, 20, 40)
            for seed in range(splits)]
    lines = ["| constant | halved | as it is | doubled |", "|---|---:|---:|---:|"]
    as_is = _ratio(jobs)
    for module, constant in CONSTANTS:
        value = getattr(module, constant)
        changed = []
        for factor in (0.5, 2.0):
            new = factor * np.asarray(value)
            setattr(module, constant, int(new) if isinstance(value, int) else new)
            changed.append(_ratio(jobs))
        setattr(module, constant, value)
        lines.append(f"| `{constant}` | {changed[0]:.3f} | {as_is:.3f} | {changed[1]:.3f} |")
    return "\n".join(lines)


def _ratio(jobs: list[tuple[str, int, int]]) -> float:
    """Return the median over splits of the ratio of auto's RMSE to the best plain one."""
    found = []
    for name, count, seed in jobs:
        mine, independent = split(name, count, seed)
        choice = Auto().choose(FitData.of(FeatureSet(mine, crs=crs_of(name)), heights_of(mine)))
        assert choice is not None
        found.append(rmse_of(choice.chosen.errors(independent))
                     / min(rmse_of(one.errors(independent)) for one in choice.compared
                           if one.method.name in PLAIN))
    return median(found)


def main() -> None:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder that files and studies are kept in")
    parser.add_argument("--write", action="store_true",
                        help="write docs/evidence/honest-accuracy.md")
    asked = parser.parse_args()
    wanted = asked.names or names()
    with tempfile.TemporaryDirectory() as other:
        folder: Path = asked.out or Path(other)
        folder.mkdir(parents=True, exist_ok=True)
        draw(folder, wanted, asked.counts, asked.splits)
        first, second = (studied(folder, name, asked.processes) for name in STUDIES)
        found, ga = list(rows_of(first)), against_papers(second)
    text = page(found, ga, sensitivity(wanted, min(asked.splits, 2)), asked.splits)
    put("honest-accuracy", text, write=asked.write)


def page(found: list[Row], ga: str, constants: str, splits: int) -> str:
    """Return the page."""
    return f"""# Honest accuracy

Made by the studies `benchmarks/honest-accuracy.toml` and `honest-accuracy-ga.toml`:
`python -m benchmarks.accuracy --write` draws {splits} splits of each set and number of points, a
file each, and runs both. Points are those that the model is fitted to; up to 300 others are
independent.
The best conventional model (affine, DLT or projective, quadratic, cubic, of X and Y or of X, Y and
Z) is chosen with hindsight, by the median of its independent RMSE over all splits. The embedded
scenes are simulated. Sets derived from sensor models have Gaussian noise of {NOISE} px. Seconds are
CPU seconds of the whole choice, the search for blunders included.

The studies give every RMSE and every second. The script itself looks for poles in the results that
they keep, and changes constants of the program.

## Requirement and measurement

{verdict(found)}

{missed(found)} Few points do not show which structure
will be best on that very split, and the best of several in hindsight is partly best by luck. No
rule can promise it. The last line of the next table is the structure that is best for the set and
the number of points, which nobody knows beforehand.

{rules(found)}

## Against the papers' GA

`rfm-terms` with `--solver ga` on selection RMSE (`poly-terms` where there are no heights). Half
of the points are selection points. {GA_SPLITS} of the splits at
{', '.join(map(str, GA_COUNTS))} points each.

{ga}

## Constants

The median over splits of auto's independent RMSE divided by that of the best conventional model of
the split, at 12, 20 and 40 points. Each constant of `termsel.adjustment.bayesian.posterior` and of
`termsel.auto.rule` is halved and doubled.

{constants}

## All sets

{table(found)}
"""


if __name__ == "__main__":
    main()
