"""What every command must do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from termsel.core.errors import TermselError
from termsel.testing.cases import Case, Suite, require

if TYPE_CHECKING:
    import click
    from click.testing import Result


def invoke(*words: object) -> Result:
    """Run a command line of termsel in this process: ``invoke("run", "--points", path)``.

    Returns
    -------
    click.testing.Result
        With `exit_code`, `stdout` and `stderr`; the code is 2 for what the user can correct. Other
        exceptions are faults, and pass.

    Examples
    --------
    >>> from termsel.testing import invoke
    >>> shown = invoke("describe", "affine")
    >>> shown.exit_code, shown.stdout.splitlines()[0]
    (0, 'affine: model of termsel')
    """
    from click.testing import CliRunner

    from termsel.cli.main import cli

    # An exception passes, as its traceback says more to the author of a test than an exit code.
    return CliRunner().invoke(cli, [str(argument) for argument in words], catch_exceptions=False)


@dataclass(frozen=True)
class Typed:
    """A command and the words that are typed after it."""

    command: click.Command
    words: tuple[str, ...]

    def run(self, *words: str) -> Result:
        """Return the outcome of the command with these words."""
        from click.testing import CliRunner

        return CliRunner().invoke(self.command, list(words))


def declaration(typed: Typed) -> None:
    """It has a name and a line on what it does."""
    require(typed.command.name, "it has no name")
    require(typed.command.get_short_help_str(), "it says nothing of itself; give it a docstring, "
                                                "whose first line `termsel plugins` shows")


def help_page(typed: Typed) -> None:
    """``--help`` ends with exit code 0; every option has a line of help."""
    import click

    done = typed.run("--help")
    require(done.exit_code == 0, f"--help ends with exit code {done.exit_code}: {done.output}")
    for option in typed.command.params:
        # Arguments are explained by the text of the command.
        require(not isinstance(option, click.Option) or option.help,
                f"the option {option.opts[0]} has no help")


def unknown_option(typed: Typed) -> None:
    """An option it does not have ends with exit code 2."""
    done = typed.run("--no-such-option-of-any-command")
    require(done.exit_code == 2, f"an unknown option ends with exit code {done.exit_code}, not 2")


def runs(typed: Typed) -> None:
    """It ends without a traceback: exit code 0, or 2 for what the user can correct."""
    done = typed.run(*typed.words)
    fault = done.exception
    # click leaves a program by SystemExit.
    require(fault is None or isinstance(fault, TermselError | SystemExit),
            f"{' '.join(typed.words)!r} raises {type(fault).__name__}: {fault}; raise TermselError "
            "for what the user can correct")
    require(isinstance(fault, TermselError) or done.exit_code in (0, 2),
            f"{' '.join(typed.words)!r} ends with exit code {done.exit_code}, not 0 or 2")


def cases(command: click.Command, *, words: Sequence[str] = ()) -> list[Case]:
    """Return a command with what is typed after its name."""
    typed = Typed(command, tuple(words))
    return [Case(str(getattr(command, "name", command)), lambda: typed)]


SUITE = Suite((declaration, help_page, unknown_option, runs), cases)
