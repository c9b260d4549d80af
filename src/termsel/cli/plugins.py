"""The command `termsel plugins`."""

from __future__ import annotations

import click

from termsel.cli.tables import print_json, print_table


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print a JSON array.")
def plugins(as_json: bool) -> None:
    """List plugins, and what is wrong with them.

    A plugin is a package with an entry point in the group `termsel`. A plugin that is broken,
    or uses a name that is taken, never stops termsel or another plugin.

    \b
    TERMSEL_PLUGINS=a,b   uses only the plugins of the packages a and b; none if empty
    TERMSEL_DEBUG=1       shows the traceback of an error in a plugin

    \b
    Examples:
      termsel plugins
      TERMSEL_PLUGINS= termsel list models
    """
    from termsel.plugins.registry import registry

    names = registry()
    failures = names.failures()
    reasons = {plugin: [f.what for f in failures if (f.plugin, f.distribution)
                        == (plugin.name, plugin.distribution)] for plugin in names.plugins}
    if as_json:
        print_json([{
            "name": plugin.name, "distribution": plugin.distribution, "version": plugin.version,
            "hooks": list(plugin.hooks), "status": "broken" if wrong else "ok",
            "reasons": wrong} for plugin, wrong in reasons.items()])
        return
    print_table(
        ("name", "distribution", "version", "status", "hooks"),
        [(plugin.name, plugin.distribution, plugin.version, "broken" if wrong else "ok",
          " ".join(hook.removeprefix("termsel_") for hook in plugin.hooks))
         for plugin, wrong in reasons.items()])
    for command in names.entries("commands"):
        click.echo(f"Command {command.name!r} of {command.provided_by}: {command.summary}")
    for failure in failures:
        click.echo(f"Broken: {failure}")
