"""Records of runs as tests change them, and the text that is shown of each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import convert

from termsel.data.record.record import Record
from termsel.results.answers import result_document
from termsel.results.first_screen import first_screen as first_screen_facts
from termsel.results.first_screen import next_step_for_user as next_command
from termsel.results.text import text_of, text_of_blocks


def outlier(name: str, error: float, excluded: bool, certainty: str = "certain",
            role: str = "control") -> dict[str, Any]:
    return {"id": name, "kind": "point", "role": role, "error": error, "certainty": certainty,
            "excluded": excluded}


def rmse(total: float | None, n: int = 10) -> dict[str, Any]:
    return {"line": total, "sample": total, "total": total, "n": 0 if total is None else n}


def roles(control: float | None, check: float | None, independent: float | None,
          ) -> dict[str, dict[str, Any]]:
    return {"control": rmse(control), "check": rmse(check), "independent": rmse(independent)}


def baseline(name: str, n_terms: int, figures: Mapping[str, Any], *,
             fitted_to: tuple[str, ...] = ("control", "check")) -> dict[str, Any]:
    return {"name": name, "n_terms": n_terms, "fitted_to": list(fitted_to), "determined": True,
            "predicted": None, "rmse": figures}


def record(**changed: Any) -> dict[str, Any]:
    """A record of a search, as result.json holds it, with some parts other."""
    plain: dict[str, Any] = {
        "problem": "rfm-terms", "model": "poly3d", "solver": "ga", "criterion": "press", "seed": 4,
        "options": {**{key: {} for key in ("data", "model", "solver", "criterion", "search")},
                    "problem": {}},
        "schema": "termsel-result-1", "feasible": True, "predicted": None, "accuracy": None,
        "final": None, "exported": "selection", "hit_rate": 0.0, "history": [], "budget": {},
        "interrupted": False, "coefficients": {}, "standard_deviations": {}, "plugins": {},
        "scaling": {f"{name}_{kind}": 1 for name in ("line", "sample", "x", "y", "z")
                    for kind in ("offset", "scale")},
        "fit": {"estimator": "least-squares", "options": {}, "effective": None, "held_out": None,
                "features": None},
        "data": {"source": "points.csv", "crs": "EPSG:4979", "fit_crs": "EPSG:4979",
                 "heights": "EGM96",
                 "sha256": "0" * 64, "noise": None, "image_size": None,
                 "roles": {key: [] for key in ("control", "check", "independent", "off")},
                 "counts": {"control": 24, "lines": 0, "check": 12, "independent": 9, "off": 0}},
        "selection": {"terms": ["line:1", "line:X"], "features": ["A", "B"], "n_terms": 2,
                      "n_features": 2, "parameters": {}},
        "offered": {"n_terms": 2, "n_features": 2},
        "rmse": roles(1.0, 2.0, 3.0),
        "baselines": [baseline("all-terms", 20, roles(0.5, 5.0, 6.0), fitted_to=("control",))],
        "judgement": "It is good.", "notes": [], "front": [], "certificate": None,
        "strategy": None, "evaluations": 500, "lookups": 30, "generations": 7, "seconds": 1.25,
        "polish": None, "adjustment": {
            "equations": 48, "terms": 2, "redundancy": 46, "rank": 2, "condition": None,
            "sigma0": None, "orientation_spread": None}, "objectives": {"press": 1.0},
        "significance": {}, "correlations": [], "outliers": [],
        "versions": {"termsel": "9.9"}}
    return {**plain, **changed}


def data(**changed: Any) -> dict[str, Any]:
    return {**record()["data"], **changed}


def counts(**changed: int) -> dict[str, Any]:
    return data(counts={**record()["data"]["counts"], **changed})


def share(most: float) -> dict[str, Any]:
    return {"options": {**record()["options"], "problem": {"max_share": most}}}


def text(whole: bool = True, **changed: Any) -> str:
    return text_of(result_document(convert(record(**changed), Record)), with_details=whole,
                   titled=False)


def first_screen(**changed: Any) -> list[str]:
    """Return the lines of the first screen, but for the command that comes last."""
    return text_of_blocks(first_screen_facts(convert(record(**changed), Record))).splitlines()


def next_step(folder: str, **changed: Any) -> str:
    """Return the last line of the first screen of a result in a folder."""
    return next_command(convert(record(**changed), Record), folder)


def page(**changed: Any) -> list[str]:
    """Return the lines of the whole summary from the first heading on."""
    lines = text(**changed).splitlines()
    return lines[lines.index("How accurate is it?"):]


def added(**changed: Any) -> list[str]:
    """Return the lines that a change of the record adds or changes below the first heading."""
    before = page()
    return [line for line in page(**changed) if line not in before]
