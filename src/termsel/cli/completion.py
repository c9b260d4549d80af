"""The command `termsel completion`."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print a script that completes commands and names in a shell.

    It completes commands, options, and the names of problems, models, solvers and data sets,
    also those of plugins.

    \b
    Examples:
      eval "$(termsel completion bash)"          in ~/.bashrc
      eval "$(termsel completion zsh)"           in ~/.zshrc
      termsel completion fish | source           in ~/.config/fish/config.fish
    """
    program = context.find_root()
    found = get_completion_class(shell)
    assert found is not None
    script = found(program.command, {}, "termsel", "_TERMSEL_COMPLETE")
    # Not source(), which asks the shell, perhaps not this machine's, for its version.
    click.echo(script.source_template % script.source_vars())
