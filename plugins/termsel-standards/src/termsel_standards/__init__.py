"""Accuracy stated by standards, as a plugin.

References
----------
ASPRS Positional Accuracy Standards for Digital Geospatial Data, edition 2, version 2 (2024).
FGDC-STD-007.3-1998, Geospatial Positioning Accuracy Standards, part 3: National Standard for
Spatial Data Accuracy.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel import Writer
    from termsel_standards.errors import GroundErrors, errors_of, read_errors
    from termsel_standards.sigma import write_sigma
    from termsel_standards.statement import Statement, Statements, statements_of

# What is not needed for `termsel run` is not imported for it.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "errors": ["GroundErrors", "errors_of", "read_errors"],
    "sigma": ["write_sigma"],
    "statement": ["Statement", "Statements", "statements_of"]})

__all__ = ["GroundErrors", "Statement", "Statements", "errors_of", "read_errors",
           "statements_of", "write_sigma"]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the commands."""
    from termsel_standards.command import accuracy
    from termsel_standards.sigma_command import sigma

    cli.add_command(accuracy)
    cli.add_command(sigma)


@hookimpl
def termsel_writers() -> Iterable[type[Writer]]:
    """Return the writers of STAC items and of quality reports."""
    from termsel_standards.quality.writers import FgdcXml, Iso19157Json, Iso19157Xml
    from termsel_standards.stac import StacItem

    return [StacItem, Iso19157Xml, Iso19157Json, FgdcXml]
