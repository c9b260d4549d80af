"""Help of a command with many options: the main ones by topic, all of them on request."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from termsel.cli.messages import echo

TOPICS: Mapping[str, Mapping[str, str]] = {
    "Input": {
        "points": "Points, in any format of `termsel list readers`.",
        "lines": "Control lines, in any format of `termsel list readers`.",
        "image": "The image: its size, and its RPC if it has one.",
        "rpc": "The vendor's RPC, which auto corrects by the points.",
        "dem": "Raster of heights, for points that have none.",
        "crs": "CRS of the ground coordinates: EPSG:n or local.",
        "columns": "Which column is which: line=4,sample=5,x=2,y=3.",
        "off": "Points and lines to leave out: P07,P12.",
        "role": "Roles, in place of the file's: P07=independent,P12=control."},
    "Model (chosen automatically unless you ask)": {
        "problem": "Kind of search; see `termsel list problems`.",
        "model": "Sensor model; see `termsel list models`.",
        "solver": "Search method; see `termsel list solvers`.",
        "strategy": "auto chooses a model; as-asked runs a search.",
        "settings": "Any further option; see `termsel describe NAME`.",
        "seed": "Seed of the search [default: 1].",
        "seconds": "Stop the search after S seconds."},
    "Output": {
        "out": "Folder for the result.",
        "exports": "Write this format there, too, such as rpb.",
        "reports": "Write the page report.html there, too.",
        "overwrite": "Replace existing files.",
        "verbose": "Print every table, term and proof.",
        "as_json": "Print JSON alone on stdout."},
}
"""Options of the short help by topic, each in one line."""


class ByTopic(click.Command):
    """A command whose ``--help`` has the main options by topic, and ``--help-all`` all of them."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, with the option that shows all of them."""
        help_all = click.Option(["--help-all"], is_flag=True, is_eager=True, expose_value=False,
                                callback=_show_all, help="Show all options and exit.")
        return [*super().get_params(ctx), help_all]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the main options by topic, or all options, as click does, for --help-all."""
        if ctx.meta.get(_ALL_OPTIONS_ASKED):
            super().format_options(ctx, formatter)
            return
        options = {option.name: option for option in self.get_params(ctx)
                   if isinstance(option, click.Option)}
        for topic, texts in TOPICS.items():
            # Options of plugins are not listed here, and need not be installed.
            rows = [(_option_synopsis(options[name]), text) for name, text in texts.items()
                    if name in options]
            with formatter.section(topic):
                formatter.write_dl(rows)
        formatter.write_paragraph()
        formatter.write_text("All options: --help-all")


_ALL_OPTIONS_ASKED = "termsel.help-all"
"""Where a context keeps that all options are asked for."""


def _show_all(context: click.Context, _: click.Parameter, is_asked_for: bool) -> None:
    """Print the help with all options, and end the command."""
    if is_asked_for and not context.resilient_parsing:
        context.meta[_ALL_OPTIONS_ASKED] = True
        echo(context.get_help())
        context.exit()


def _option_synopsis(option: click.Option) -> str:
    """Return an option with the name of its value."""
    if option.is_flag:
        return option.opts[0]
    value = "auto|as-asked" if isinstance(option.type, click.Choice) else option.metavar or "N"
    return f"{option.opts[0]} {value}"


class Whole(click.IntRange):
    """A whole number in a range that help does not spell out: it is no real limit."""

    def _describe_range(self) -> str:
        return ""

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> int:
        """Return the number; raise BadParameter for one outside the range, with the range."""
        number = int(click.INT.convert(value, param, ctx))
        too_small = self.min is not None and number < self.min
        too_large = self.max is not None and number > self.max
        if too_small or too_large:
            self.fail(f"{number} is not in the range {super()._describe_range()}.", param, ctx)
        return number
