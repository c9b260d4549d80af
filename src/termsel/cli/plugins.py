"""The command `termsel plugins`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from termsel.cli.messages import echo
from termsel.cli.tables import print_json, print_table
from termsel.core.version import PLUGIN_API, plugin_bound

if TYPE_CHECKING:
    from termsel.plugins.loading import Plugin, Remark

SLOW = 0.3
"""Seconds that a user notices."""


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print a JSON array.")
@click.option("--time", "timed", is_flag=True,
              help="Show the seconds that each plugin takes: its import, and all its hooks.")
def plugins(as_json: bool, timed: bool) -> None:
    """List installed plugins, and errors in them.

    A plugin is a package with an entry point in the group `termsel`. A plugin that is broken,
    or uses a name that is taken, never stops termsel or another plugin.

    \b
    TERMSEL_PLUGINS=a,b   uses only the plugins of the packages a and b; none if empty
    TERMSEL_DEBUG=1       shows the traceback of an error in a plugin

    \b
    Examples:
      termsel plugins
      termsel plugins --time
      TERMSEL_PLUGINS= termsel list models
    """
    from termsel.plugins.registry import Registry, registry

    if timed:
        Registry([]).failures()  # imports what is built in, which else the first plugin would do
    names = registry()
    # Failures are those of loading, and those of names that clash.
    failures = names.failures()
    seconds = names.seconds() if timed else {}
    if as_json:
        print_json([{
            "name": plugin.name, "distribution": plugin.distribution, "version": plugin.version,
            "api": PLUGIN_API, "requires": plugin.requires, "hooks": list(plugin.hooks),
            "status": _status_text(plugin, failures),
            "reasons": _line_about_plugin(plugin, failures),
            **({"seconds": round(seconds.get(plugin, 0.0), 4)} if timed else {})}
            for plugin in names.plugins])
        return
    echo(f"Plugin API {PLUGIN_API}: packages that provide plugins state "
         f"termsel{plugin_bound()}\n")
    print_table(
        ("name", "distribution", "version", "requires termsel", "status",
         *(["seconds"] if timed else []), "hooks"),
        [(plugin.name, plugin.distribution, plugin.version, plugin.requires,
          _status_text(plugin, failures),
          *([f"{seconds.get(plugin, 0.0):.3f}"] if timed else []),
          " ".join(hook.removeprefix("termsel_") for hook in plugin.hooks))
         for plugin in names.plugins])
    # The time of termsel's own parts is not the user's to change.
    slow = [plugin for plugin, duration in seconds.items() if duration > SLOW]
    for plugin in slow:
        if plugin.distribution != "termsel":
            echo(f"Slow: plugin {plugin.name!r} of {plugin.distribution} {plugin.version} takes "
                 f"{seconds[plugin]:.1f} s. Its author can import slow modules inside functions.")
    for command in names.entries("commands"):
        echo(f"Command {command.name!r} of {command.provided_by}: {command.summary}")
    for failure in failures:
        echo(f"Broken: {failure}")


def _line_about_plugin(plugin: Plugin, remarks: list[Remark]) -> list[str]:
    return [remark.what for remark in remarks
            if (remark.plugin, remark.distribution) == (plugin.name, plugin.distribution)]


def _status_text(plugin: Plugin, failures: list[Remark]) -> str:
    """Return whether a plugin is ok or broken."""
    return "broken" if _line_about_plugin(plugin, failures) else "ok"
