"""Parts of packages that termsel asks for at one place, and does without where there are none."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from termsel.errors import TermselError


@dataclass(frozen=True)
class Part:
    """What a package gives termsel for one place.

    Parameters
    ----------
    place : str
        "study": a `StudyOutput`, what is made of a study. "study-map": what makes a map of its
        images, called as `termsel_studies.map_of`. "scheduler": what runs cells, called as
        `termsel_cluster.on_cluster`. "certificate": what makes the writer of a certificate, called
        as `termsel_bench.certificate.certifier`.
    value : object
        What the place takes.
    """

    place: str
    value: Any


sources: list[Callable[[], Iterable[Part]]] = []
"""What gives the parts of plugins: the registry, which lies above this room, adds itself."""


def parts(place: str) -> list[Any]:
    """Return what packages give for a place; empty where none is installed."""
    return [part.value for source in sources for part in source() if part.place == place]


def part(place: str, what: str) -> Any:
    """Return what a package gives for a place; refuse where none does. `what` has its verb."""
    if found := parts(place):
        return found[0]
    raise missing(place, what)


def missing(place: str, what: str) -> TermselError:
    """Return the error that says which package a place lacks; `what` has its verb."""
    package = package_of_name(place)
    return TermselError(f"{what} the package {package}, which is not installed",
                        hint=f"In a clone of termsel: pip install ./plugins/{package}")


@cache
def own_packages() -> dict[str, list[str]]:
    """Return the names that each plugin package of termsel's own provides, by distribution."""
    found: dict[str, list[str]] = json.loads(
        (files("termsel.plugins") / "packages.json").read_text("utf-8"))
    return found


def package_of_name(name: str) -> str:
    """Return which package of termsel's own provides a name; nothing if none does."""
    return next((one for one, names in own_packages().items() if name in names), "")
