"""What every command must do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from termsel.errors import TermselError
from termsel.testing.checks import Case, Check, assemble, require, run_all

if TYPE_CHECKING:
    import click
    from click.testing import Result


@dataclass(frozen=True)
class Typed:
    """A command and the words that are typed after it.

    Parameters
    ----------
    command : click.Command
    words : tuple of str
    """

    command: click.Command
    words: tuple[str, ...]

    def run(self, *words: str) -> Result:
        """Return the outcome of the command with these words."""
        from click.testing import CliRunner

        return CliRunner().invoke(self.command, list(words))


def declaration(typed: Typed) -> None:
    """It is a click command with a name and a line on what it does."""
    import click

    require(isinstance(typed.command, click.Command),
            f"it must be a click.Command, not {type(typed.command).__name__}")
    require(typed.command.name, "it has no name")
    require(typed.command.get_short_help_str(), "it says nothing of itself; give it a docstring, "
                                                "whose first line `termsel plugins` shows")


def help_page(typed: Typed) -> None:
    """``--help`` ends with exit code 0; every option has a line of help."""
    import click

    done = typed.run("--help")
    require(done.exit_code == 0, f"--help ends with exit code {done.exit_code}: {done.output}")
    for option in typed.command.params:
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
    require(fault is None or isinstance(fault, TermselError | SystemExit),
            f"{' '.join(typed.words)!r} raises {type(fault).__name__}: {fault}; raise TermselError "
            "for what the user can correct")
    require(isinstance(fault, TermselError) or done.exit_code in (0, 2),
            f"{' '.join(typed.words)!r} ends with exit code {done.exit_code}, not 0 or 2")


COMMAND_CHECKS = (declaration, help_page, unknown_option, runs)


def command_checks(command: click.Command, words: Sequence[str] = (), *,
                   expected_failures: Mapping[str, str] | None = None) -> tuple[Check, ...]:
    """Return the checks of a command, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    command : click.Command
    words : sequence of str
        What a user types after its name.
    expected_failures : mapping, optional
        Checks it is known to fail, by name, with the reason.

    Returns
    -------
    tuple of Check

    Raises
    ------
    TermselError
        For an expected failure of a check that does not exist.
    """
    typed = Typed(command, tuple(words))
    return assemble(COMMAND_CHECKS, [Case(str(getattr(command, "name", command)), lambda: typed)],
                    expected_failures)


def check_command(command: click.Command, words: Sequence[str] = (), *,
                  expected_failures: Mapping[str, str] | None = None) -> None:
    """Run all checks of a command.

    Parameters
    ----------
    command, words, expected_failures
        As `command_checks`.

    Raises
    ------
    AssertionError
        Naming every check that fails, and what is wrong.
    """
    run_all(command_checks(command, words, expected_failures=expected_failures))
