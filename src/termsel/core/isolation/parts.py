"""Parts of packages that termsel asks for at one place, and does without where there are none."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from typing import Any

from termsel.core.errors import TermselError


@dataclass(frozen=True)
class Part:
    """What a package gives termsel for one slot.

    Parameters
    ----------
    slot : str
        "study": a `StudyOutput`, what is made of a study. "study-map": what makes a map of its
        images, called as `termsel_studies.map_of`. "scheduler": what runs cells, called as
        `termsel_studies.run_on_cluster`. "certificate": what makes the writer of a certificate,
        called as `termsel_bench.certificate.certificate_maker`. "reading": options of reading, as
        `termsel_cameras.known.reading.CameraOptions` has them.
    value : object
        What the slot takes.
    """

    slot: str
    value: Any


sources: list[Callable[[], Iterable[Part]]] = []
"""What gives the parts of plugins: the registry, which lies above this room, adds itself."""


def values_of_slot(slot: str) -> list[Any]:
    """Return the values that packages give for a slot; [] if no installed package does."""
    values: list[Any] = []
    for source in sources:
        values += [extension.value for extension in source() if extension.slot == slot]
    return values


def value_of_slot(slot: str, purpose: str) -> Any:
    """Return the value that a package gives for a slot; of several packages the first one loaded.

    Raises TermselError if none does; its message begins with `purpose`, which has its verb, such as
    "a certificate requires".
    """
    if extensions := values_of_slot(slot):
        return extensions[0]
    raise missing_package_error(slot, purpose)


def missing_package_error(slot: str, purpose: str) -> TermselError:
    """Return the error that says which package a slot lacks; `purpose` has its verb."""
    package = package_of_name(slot)
    state, remedy = lack_of(package)
    return TermselError(f"{purpose} the package {package}, which {state}", hint=remedy)


def lack_of(package: str) -> tuple[str, str]:
    """Return why a package of termsel's own is not in use, and the remedy.

    The first is a clause to follow "which", such as "is not installed", the second a sentence.
    """
    if is_left_out(package):
        return LEFT_OUT, "Unset that variable, or name the package in it."
    if _is_installed(package):
        return "is installed, but cannot be loaded", "termsel plugins says why."
    return "is not installed", install_hint(package)


PLUGINS_VARIABLE = "TERMSEL_PLUGINS"
"""Environment variable that lists the packages whose plugins are used."""

LEFT_OUT = f"is installed, but left out by the variable {PLUGINS_VARIABLE}"


def is_left_out(package: str) -> bool:
    """Return whether a package is installed, but left out by a variable of the environment."""
    chosen = chosen_packages()
    return (bool(package) and chosen is not None and canonical_name(package) not in chosen
            and _is_installed(package))


def chosen_packages() -> set[str] | None:
    """Return the packages that the variable lists, spelt by `canonical_name`; None if unset."""
    listed = os.environ.get(PLUGINS_VARIABLE)
    if listed is None:
        return None
    return {canonical_name(name) for name in listed.split(",") if name.strip()}


def canonical_name(distribution: str) -> str:
    """Return the one spelling of a distribution's name for "A.B", "a-b" and "a_b"."""
    return re.sub(r"[-_.]+", "-", distribution.strip()).lower()


def install_hint(package: str) -> str:
    """Return how a package of termsel's own is installed."""
    return f"In a clone of termsel: pip install ./plugins/{package}"


def package_of_option(name: str) -> str:
    """Return a sentence on the package that an option of ``--set`` comes with.

    Returns "" for an option that comes with no package.
    """
    package = package_of_name(f"{SET} {name}")
    if not package:
        return ""
    if is_left_out(package):
        return f"It is an option of the package {package}, which {LEFT_OUT}: unset it."
    if _is_installed(package):
        return (f"It is an option of the package {package}, of which this run uses no part that "
                "takes it. Choose one with --model or --method, or leave it out.")
    return (f"It is an option of the package {package}, which is not installed. "
            f"{install_hint(package)}")


SET = "--set"
"""In the list of names, what an option begins with."""


def _is_installed(package: str) -> bool:
    """Return whether a distribution is installed."""
    try:
        distribution(package)
    except PackageNotFoundError:
        return False
    return True


@cache  # a file of the package, which does not change
def own_packages() -> dict[str, list[str]]:
    """Return the names that each plugin package of termsel's own provides, by distribution.

    Options that only such a package has are among them, as "--set NAME".
    """
    names_by_package: dict[str, list[str]] = json.loads(
        (files("termsel.plugins") / "packages.json").read_text("utf-8"))
    return names_by_package


def package_of_name(name: str) -> str:
    """Return the package of termsel's own that provides a name; "" if none does."""
    return next((package for package, names in own_packages().items() if name in names), "")
