"""Files of other programs, and what these programs make of them, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader  # type: ignore[import-untyped]

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel import Reader
    from termsel_formats.check.comparison import Deviation, compared
    from termsel_formats.check.programs import Taken, taken_by

# What is not needed for `termsel run` is not imported for it.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "check.comparison": ["Deviation", "compared"], "check.programs": ["Taken", "taken_by"]})

__all__ = ["Deviation", "Taken", "compared", "taken_by"]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command."""
    from termsel_formats.check.command import check

    cli.add_command(check)


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return the readers of points."""
    from termsel_formats.points.asp import AspGcp
    from termsel_formats.points.envi import EnviPoints
    from termsel_formats.points.mapinfo import MapInfoTab
    from termsel_formats.points.metashape import MetashapeMarkers
    from termsel_formats.points.ozi import OziMap

    return [EnviPoints, AspGcp, MapInfoTab, OziMap, MetashapeMarkers]
