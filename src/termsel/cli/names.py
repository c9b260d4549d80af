"""Completion of names in the shell."""

from __future__ import annotations

from collections.abc import Callable

import click
from click.shell_completion import CompletionItem

Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def complete(*kinds: str) -> Completer:
    """Return a ``shell_complete`` for options and arguments that take a name.

    Parameters
    ----------
    *kinds : str
        Of `termsel.plugins.kinds.KINDS`; all of them by default.
    """
    def items(
        context: click.Context, parameter: click.Parameter, incomplete: str  # noqa: ARG001
    ) -> list[CompletionItem]:
        from termsel.plugins.kinds import KINDS
        from termsel.plugins.manager import registry

        return [CompletionItem(entry.name, help=entry.summary)
                for kind in kinds or KINDS for entry in registry().entries(kind)
                if entry.name.startswith(incomplete)]

    return items
