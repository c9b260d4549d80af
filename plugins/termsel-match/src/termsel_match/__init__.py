"""Control from the image itself: points and lines matched with an orthoimage and with vectors.

References
----------
Konugurthi, Kune, Nooka, Sarma 2016: Autonomous ortho-rectification of very high resolution
imagery using SIFT and genetic algorithm. PE&RS 82(5), 377-388.
Yavari, Valadan Zoej, Salehi 2018: An automatic optimum number of well-distributed ground control
lines selection procedure. ISPRS Journal 139, 46-56.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel import Criterion, Reader, Recipe
    from termsel_match.matchers import Matcher


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the commands."""
    from termsel_match.commands import add_commands

    add_commands(cli)


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return readers of what other programs have matched."""
    from termsel_match.asp import AspMatches
    from termsel_match.points.readers import ArosicsTable, MatchesCsv

    return [ArosicsTable, AspMatches, MatchesCsv]


@hookimpl
def termsel_matchers() -> Iterable[type[Matcher]]:
    """Return SIFT, phase correlation, and one for other contrast."""
    from termsel_match.matchers.phase import Phase
    from termsel_match.matchers.sift import Sift
    from termsel_match.matchers.structure import Structure

    return [Sift, Phase, Structure]


@hookimpl
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return the agreement of candidates."""
    from termsel_match.judgement.criteria import Agreement

    return [Agreement]


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the selection of matched lines."""
    from termsel_match.lines.problem import RECIPE

    return [RECIPE]
