"""The option that says which of a result's two fits a command takes."""

from __future__ import annotations

import click

final_option = click.option(
    "--final/--no-final", default=None,
    help="Take the fit of the chosen model to all points, independent ones included, or the fit "
         "without them. By default the first, where auto chose a model.")
