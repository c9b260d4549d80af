"""Results of methods as files, and their check: the method runs again on the same sets."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from termsel import TermselError, __version__
from termsel.toolkit import read_text
from termsel.toolkit.runs import exception_in_words
from termsel_bench.methods.base import METHOD_KINDS, Method
from termsel_bench.protocol import Score, score_all
from termsel_bench.scenes.catalogue import QUICK, SETS, frozen_checksums
from termsel_bench.scenes.measured import checksums_of_measured, first_of_each_kind

SUBMISSION_SCHEMA = "termsel-bench-1"

REPEATED_SHARE = 0.01
"""Share by which a repeated RMSE may differ: machines and versions of libraries round otherwise."""


@dataclass(frozen=True)
class Submitted:
    """Results of a method: its RMSE on each set [px], None where it has none."""

    path: Path
    method: Method
    rmse: dict[str, float | None]


@dataclass(frozen=True)
class Checked:
    """What a check found: sets that were repeated, and those whose RMSE is another."""

    submitted: Submitted
    repeated: int
    refuted: tuple[str, ...]
    worst: float


def texts_of(scored: Sequence[Score]) -> dict[str, str]:
    """Return the text of a file of results for each method, by the name of the file.

    Only frozen sets are in it; a method that ran on none of them has no file.
    """
    frozen = _frozen_checksums()
    files = {}
    for method in dict.fromkeys(score.method.title for score in scored):
        # Figures of other sets, which may change, could not be compared later.
        method_scores = [score for score in scored if score.method.title == method
                         and score.set_name in frozen]
        if not method_scores:
            continue
        stated_method = method_scores[0].method
        content = {
            "schema": SUBMISSION_SCHEMA, "termsel": __version__,
            "method": {"kind": stated_method.kind, "name": stated_method.name,
                       "options": dict(stated_method.options),
                       "problem": stated_method.problem},
            "sets": {score.set_name: {
                "sha256": frozen[score.set_name],
                "rmse": round(score.rmse, 6) if math.isfinite(score.rmse) else None}
                for score in method_scores}}
        name = re.sub(r"[^A-Za-z0-9]+", "-", method).strip("-")
        files[f"{name}.json"] = json.dumps(content, indent=1) + "\n"
    return files


def _frozen_checksums() -> dict[str, str]:
    """Return the SHA-256 of the points of each set, simulated and measured."""
    simulated = frozen_checksums()
    return {**{name: simulated[f"{name}.csv"] for name in SETS}, **checksums_of_measured()}


def read_submitted(folder: Path, packages: Sequence[str] = ()) -> list[Submitted]:
    """Return the results in a folder.

    Parameters
    ----------
    folder : Path
    packages : sequence of str
        Functions that may be imported, as module:function: a file of results alone names no code.

    Raises
    ------
    TermselError
        If there is none, one is not of the form, or is of a package that is not among `packages`.
    """
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise TermselError(f"{folder} has no results",
                           hint="Put the .json files there that `termsel bench --out DIR` writes.")
    return [_read(path, packages) for path in paths]


def _read(path: Path, packages: Sequence[str]) -> Submitted:
    """Return the results of a method in a file.

    Raises TermselError if the file has no results, if its method is unknown or is code that is not
    among `packages`, and for sets that are unknown or of another version.
    """
    def refused(problem: str) -> TermselError:
        """Return the error for a file of which a clause says what is wrong."""
        return TermselError(f"{path} {problem}",
                            hint="Give what `termsel bench --out DIR` wrote.")

    try:
        content: Any = json.loads(read_text(path))
        if str(content["schema"]).startswith("termsel-result-"):
            raise refused("is the record of a run, not of a benchmark")
        if content["schema"] != SUBMISSION_SCHEMA:
            raise refused(f"is no file of a benchmark: its schema is {content['schema']!r}, not "
                          f"{SUBMISSION_SCHEMA!r}")
        stated = content["method"]
        sets = content["sets"]
        method = Method(str(stated["kind"]), str(stated["name"]),
                        {str(key): str(value) for key, value in stated["options"].items()},
                        str(stated["problem"]), file=str(path))
        rmse = {str(name): None if entry["rmse"] is None else float(entry["rmse"])
                for name, entry in sets.items()}
        sums = {str(name): entry["sha256"] for name, entry in sets.items()}
    except KeyError as error:
        raise refused(f"is no file of results of a benchmark: it has no {error.args[0]!r}"
                      ) from error
    except (OSError, ValueError, TypeError, AttributeError) as error:
        reason = exception_in_words(error)
        raise refused(f"is no file of results of a benchmark: {reason}") from error
    if method.kind not in METHOD_KINDS:
        raise refused(f"names a method of the kind {method.kind!r}")
    if method.kind == "package" and method.name not in packages:
        raise TermselError(f"{path} names code to run: {method.name!r:.100}",
                           hint="If you trust it, name it yourself: --package MODULE:FUNCTION.")
    method.require()
    frozen = _frozen_checksums()
    for name in rmse:
        if name not in frozen:
            raise refused(f"names the set {name!r}, which there is not")
        # The checksum of its points tells the version of a set.
        if sums[name] != frozen[name]:
            raise refused(f"is of another version of the set {name}")
    if not rmse:
        raise refused("has no sets")
    return Submitted(path, method, rmse)


def check(submitted: Submitted, pattern: str = "", *, quick: bool = False,
          processes: int = 1) -> Checked:
    """Run a method again on its sets whose names contain a text, and return the comparison.

    If quick, only those are run again that ``termsel bench --quick`` runs, of either suite.

    Raises
    ------
    TermselError
        If the method is not installed, or none of its sets has the text, or none is a quick one.
    """
    names = [name for name in submitted.rmse if pattern in name]
    if not names:
        raise TermselError(f"{submitted.path} has no set {pattern!r}",
                           hint=f"It has {', '.join(submitted.rmse)}.")
    if quick:
        of_quick = {*QUICK, *first_of_each_kind(names)}
        names = [name for name in names if name in of_quick]
        if not names:
            raise TermselError(f"{submitted.path} has no set of --quick", hint="Leave --quick out.")
    refuted = []
    worst = 0.0
    for repeated_score in score_all([submitted.method], names, processes=processes):
        submitted_rmse = submitted.rmse[repeated_score.set_name]
        if submitted_rmse is not None and "not installed" in repeated_score.why:
            raise TermselError(f"{submitted.path.name} cannot be repeated here: "
                               f"{repeated_score.why}",
                               hint="Install it, or move the file out of the folder.")
        repeated_rmse = repeated_score.rmse if math.isfinite(repeated_score.rmse) else None
        # A set without a result must have none again. A ratio to an RMSE of 0 does not exist, so
        # that one is always refuted.
        if submitted_rmse is None or repeated_rmse is None:
            difference = 0.0 if submitted_rmse is repeated_rmse else math.inf
        else:
            difference = abs(repeated_rmse / submitted_rmse - 1) if submitted_rmse > 0 else math.inf
        worst = max(worst, difference)
        if difference > REPEATED_SHARE:
            refuted.append(repeated_score.set_name)
    return Checked(submitted, len(names), tuple(refuted), worst)
