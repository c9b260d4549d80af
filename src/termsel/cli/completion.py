"""The command `termsel completion`."""

from __future__ import annotations

from collections.abc import Callable

import click
from click.shell_completion import CompletionItem, get_completion_class

from termsel.cli.messages import stream_of_results

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", metavar="SHELL", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print a script that completes commands and names in a shell.

    It completes commands, options, and the names of problems, models, solvers and data sets,
    including those of plugins.

    \b
    Examples:
      eval "$(termsel completion bash)"          in ~/.bashrc
      eval "$(termsel completion zsh)"           in ~/.zshrc
      termsel completion fish | source           in ~/.config/fish/config.fish
    """
    # The shell calls the program again with this variable set, and reads names from its stdout.
    program = context.find_root()
    class_of_shell = get_completion_class(shell)
    assert class_of_shell is not None
    script = class_of_shell(program.command, {}, "termsel", "_TERMSEL_COMPLETE")
    # Not source(), which asks the shell, perhaps not this machine's, for its version.
    click.echo(script.source_template % script.source_vars(), file=stream_of_results())


Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def complete(*kinds: str) -> Completer:
    """Return a ``shell_complete`` for the names of these kinds of things, by default of all."""
    def completions_of(
        context: click.Context, parameter: click.Parameter, incomplete: str  # noqa: ARG001
    ) -> list[CompletionItem]:
        """Return the names that begin with the text typed so far, with their summaries."""
        from termsel.plugins.kinds import KINDS
        from termsel.plugins.registry import registry

        completions: list[CompletionItem] = []
        for kind in kinds or KINDS:
            completions += [CompletionItem(entry.name, help=entry.summary)
                      for entry in registry().entries(kind) if entry.name.startswith(incomplete)]
        return completions

    return completions_of
