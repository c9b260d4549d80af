"""The group of all commands, and the handling of their errors.

Exit codes: 0 done; 2 the user can correct it; 1 a bug in termsel; 130 interrupted. In tests,
``click.testing.CliRunner().invoke(cli, [...])`` gives output and exit code.
"""

from __future__ import annotations

import errno
import os
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NoReturn

import click

from termsel.cli.messages import (
    echo,
    give_back_stdout,
    say_doubts,
    stream_of_results,
    take_stdout,
)
from termsel.cli.typed import command_with, keep_words
from termsel.cli.usage import hint_for, usage_message
from termsel.core.errors import TermselError, cut, unknown_name_error
from termsel.core.interrupts import INTERRUPTED, take_pending_interrupt
from termsel.core.version import __version__
from termsel.plugins.commands import COMMANDS, GROUPS, PACKAGES

CORRECTABLE = 2

_UNWRITABLE = {errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF,
               errno.EAGAIN}


def _is_of_stdout(error: Exception) -> bool:
    """Return whether an error is that of a closed or full stdout, not that of a named file."""
    return (isinstance(error, OSError) and error.errno in _UNWRITABLE
            and error.filename is None)


@contextmanager
def _stdout_may_end() -> Iterator[None]:
    """End the program silently when the reader of its output, such as head, has ended.

    Raises TermselError where stdout cannot be written for another reason, such as a full disk.
    """
    try:
        yield
        stream_of_results().flush()
    except OSError as error:
        if not _is_of_stdout(error):
            raise
        # Python flushes stdout once more when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream_of_results().fileno())
        # As head ends a pipe: everything that was wanted has been read.
        if isinstance(error, BrokenPipeError):
            raise click.exceptions.Exit(0) from None
        raise TermselError(f"cannot write to stdout: {error.strerror}",
                           hint="Check where the output goes, and the free space there."
                           ) from error


class Commands(click.Group):
    """Commands, imported when used: built-in ones, then those of plugins."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the built-in commands; plugins are not loaded, so that help is quick."""
        return list(COMMANDS)

    def get_command(
        self, ctx: click.Context, cmd_name: str
    ) -> click.Command | None:
        """Return the command of a name, None if there is none.

        Where the plugin that has it is broken, a command is returned that shows why.
        """
        if cmd_name in COMMANDS:
            # Imported by name, so that one command does not load what others need.
            module, _, attribute = COMMANDS[cmd_name][0].partition(":")
            return _print_alone(getattr(import_module(module), attribute))
        # Loading plugins runs their code, which may print.
        take_stdout()
        try:
            return _plugin_command(cmd_name)
        finally:
            give_back_stdout()

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and remaining arguments.

        Raises TermselError for an unknown command, and UsageError for an option of one value that
        is given twice. While a shell asks for completions nothing is raised, and the command may be
        None.
        """
        command = self.get_command(ctx, args[0])
        if command is None and not ctx.resilient_parsing:
            if os.path.isfile(args[0]):
                raise TermselError(f"{args[0]} is a file, and a command comes first",
                                   hint=f"Points are fitted by: termsel run {shlex.quote(args[0])}")
            raise _unknown_command_error(args[0])
        if command is not None and not ctx.resilient_parsing:
            values, order = _parsed(command, args[1:])
            _refuse_repeated(order)
            _refuse_numbers_as_files(command, values)
            _refuse_exchanged(command, values, args)
        return args[0], command, args[1:]

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write the summaries of all installed commands in groups, without importing them."""
        summaries = {name: summary for name, (_, summary) in COMMANDS.items()}
        for package, commands in PACKAGES.items():
            if find_spec(package) is not None:
                # find_spec looks for a package without importing it, which would take seconds for
                # all.
                summaries |= commands
        width = max(map(len, summaries))
        for group, names in GROUPS.items():
            rows = [(name.ljust(width), summaries[name]) for name in names if name in summaries]
            # Without further packages a group may be empty, which write_dl does not take.
            if rows:
                with formatter.section(group):
                    formatter.write_dl(rows)

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        """Return the context of a call; prints help and version."""
        # click takes words out of the list as it reads them.
        words = [*args]
        with _stdout_may_end():
            context = super().make_context(info_name, args, parent, **extra)
        keep_words(context, words)
        return context

    def invoke(self, ctx: click.Context) -> Any:
        """Call the command."""
        with _stdout_may_end():
            return super().invoke(ctx)

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        gives_back: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command line and leave the program with an exit code.

        A command that returns a whole number chooses the exit code. Without `standalone_mode` that
        value is returned, and exceptions are raised. At the end stdout is given back to whatever
        prints, unless `gives_back` is False: then a thread of a plugin that prints on and on prints
        nothing after the results.
        """
        try:
            # click would print errors and exit by itself; termsel has words of its own for them.
            if standalone_mode:
                self._end_with_code(args, prog_name, complete_var, **extra)
            return super().main(args, prog_name, complete_var, False, **extra)
        finally:
            with suppress(OSError):
                stream_of_results().flush()
            if gives_back:
                give_back_stdout()

    def _end_with_code(self, args: Sequence[str] | None, prog_name: str | None,
                       complete_var: str | None, **extra: Any) -> NoReturn:
        """Run a command, print what went wrong and what to type, and end with its exit code.

        Errors that the user can correct end with code 2, as do those of click, whose words are
        replaced by those of `usage_message`; an interrupt has its own code. Anything else is a
        fault of the program and keeps its traceback. `extra` are further arguments of
        `click.Group.main`.
        """
        try:
            try:
                value = super().main(args, prog_name, complete_var, False, **extra)
            # numpy shows the shape that it cannot allocate: that becomes what to make smaller.
            except MemoryError as error:
                raise _too_large_error(error) from error
        except TermselError as error:
            say_doubts(error)
            words = sys.argv[1:] if args is None else args
            context = self._context_of(words)
            if context is not None:
                error.hint = hint_for(context, error.hint)
            echo(f"Error: {error}", err=True)
            for line in _suggested_commands(sys.argv[1:] if args is None else args, error):
                echo(line, err=True)
            sys.exit(CORRECTABLE)
        except click.exceptions.NoArgsIsHelpError as error:
            echo(error.format_message(), err=True)  # the help, and no fault
            sys.exit(CORRECTABLE)
        except click.ClickException as error:
            words = sys.argv[1:] if args is None else args
            if isinstance(error, click.UsageError) and error.ctx is None:
                error.ctx = self._context_of(words)
            echo(cut(usage_message(error, words), 2000), err=True)
            sys.exit(CORRECTABLE)
        except (click.Abort, KeyboardInterrupt):
            take_pending_interrupt()
            echo("Interrupted.", err=True)
            sys.exit(INTERRUPTED)
        sys.exit(value if isinstance(value, int) else 0)

    def _context_of(self, words: Sequence[str]) -> click.Context | None:
        """Return the context of the command that words begin with; None if they begin with none."""
        parent = click.Context(self, info_name="termsel")
        command = self.get_command(parent, words[0]) if words else None
        return None if command is None else click.Context(command, parent=parent,
                                                          info_name=words[0])


_COMMANDS_ELSEWHERE = {
    "fit": "run", "georeference": "run", "georef": "run", "adjust": "run", "solve": "run",
    "start": "run", "orthorectify": "rectify", "ortho": "rectify", "warp": "rectify",
    "transform": "project", "convert": "export", "write": "export", "info": "describe",
    "show": "report", "view": "report", "open": "report", "validate": "accuracy",
    "rmse": "accuracy", "uncertainty": "sigma", "match": "match-points", "bundle": "block",
    "batch": "compare", "examples": "example", "demo": "example"}
"""Commands by what other programs call them."""


def _unknown_command_error(name: str) -> TermselError:
    """Return the error for an unknown command: the one that is meant, or where they are listed."""
    from termsel.plugins.registry import registry

    meant = _COMMANDS_ELSEWHERE.get(name.lower())
    summaries = {command: summary for command, (_, summary) in COMMANDS.items()}
    summaries |= {entry.name: entry.summary for entry in registry().entries("commands")}
    # Those of plugins are cut; what help prints is not.
    for package, commands in PACKAGES.items():
        summaries |= commands if find_spec(package) is not None else {}
    if meant in summaries:
        return TermselError(f"unknown command {name!r}", name=name, code="command-unknown",
                            hint=f"Did you mean {meant}? {summaries[meant]} All commands: termsel "
                                 "--help.")
    hint = registry().hint(name, "commands")
    # A command of a package that is left out: nobody has mistyped it.
    if hint and name in summaries:
        return TermselError(f"unknown command {name!r}", name=name, code="command-unknown",
                            hint=hint)
    error = unknown_name_error("command", name, summaries, hint)
    if "Did you mean" not in str(error):
        error.hint = f"{hint} All commands, in groups: termsel --help.".strip()
    return error


def _too_large_error(error: MemoryError) -> TermselError:
    """Return the error that says what did not fit into memory."""
    from termsel.core.isolation.memory import out_of_memory

    return out_of_memory(error)


def _suggested_commands(words: Sequence[str], error: TermselError) -> Iterator[str]:
    """Yield the commands that an error suggests, each with a label such as "Ready to run".

    They are the words of the user with the options of the error in place of theirs. Where a table
    can be read in several ways, each has its command. None is yielded without such options, and
    where a command cannot be printed as it must be typed.
    """
    guesses = error.guesses or [error.options.get("--columns", "")]
    for number, columns in enumerate(guesses, 1):
        options = {**error.options, "--columns": columns} if columns else error.options
        typed = command_with(options, words=words)
        if not options or not typed:
            continue
        # A question mark is for the user to fill in: such a command cannot run as it is.
        is_incomplete = "?" in "".join(options.values())
        if is_incomplete:
            verb = "Complete and run"
        elif not error.guesses:
            verb = "Ready to run"
        elif len(guesses) > 1:
            verb = f"Guess {number} of {len(guesses)}, to check"
        else:
            verb = "A guess, to check"
        yield f"{verb}: {typed}"


def _refuse_repeated(order: list[click.Parameter]) -> None:
    """Raise UsageError for an option of one value given twice: click drops the first silently.

    `order` are the parameters as typed.
    """
    for option, times in Counter(order).items():
        if times > 1 and isinstance(option, click.Option) and not (
                option.multiple or option.is_flag or option.count):
            raise click.UsageError(f"{option.opts[0]} is given {times} times; it takes one value.")


def _parsed(command: click.Command,
            words: list[str]) -> tuple[dict[str, Any], list[click.Parameter]]:
    """Return values by parameter, and the parameters in the order typed.

    Both are empty where click cannot parse the words: the command itself says what is wrong.
    """
    # The parser is that of click, so that abbreviations and clusters of flags count alike.
    parser = command.make_parser(click.Context(command, resilient_parsing=True))
    try:
        values, _, order = parser.parse_args(list(words))
    except click.UsageError:
        return {}, []
    return values, order


_BARE_NUMBER = re.compile(r"[+-]?[0-9]+([.,][0-9]+)?")


def _refuse_numbers_as_files(command: click.Command, values: Mapping[str, Any]) -> None:
    """Raise UsageError for a number where an option takes a file, unless a file is called so."""
    options = {param.name: param for param in command.params if isinstance(param, click.Option)}
    for name, option in options.items():
        value = values.get(name)
        if (option.metavar != "FILE" or not isinstance(value, str) or os.path.exists(value)
                or not _BARE_NUMBER.fullmatch(value)):
            continue
        remedy = "Give the name of a file."
        if name == "dem" and "height" in options:
            remedy = f"One height for all of the ground is given so: --height {value}."
        elif name == "dem":
            remedy = ("Give a raster of heights; heights of the points are the column z of their "
                      "file.")
        raise click.UsageError(f"{option.opts[0]} takes a file, and {value} is a number. {remedy}")


def _refuse_exchanged(command: click.Command, values: Mapping[str, Any],
                      words: list[str]) -> None:
    """Raise TermselError where a file stands before the folder of its result, as typed, exchanged.

    `words` are those typed after termsel.
    """
    from termsel.core.files.names import RECORD

    arguments = [param for param in command.params if isinstance(param, click.Argument)]
    if [param.metavar for param in arguments[:1]] != ["DIR"] or len(arguments) < 2:
        return
    file, folder = (values.get(str(param.name)) for param in arguments[:2])
    if not (isinstance(file, str) and isinstance(folder, str) and os.path.isfile(file)
            and os.path.isfile(os.path.join(folder, RECORD))):
        return
    exchanged = {file: folder, folder: file}
    missing = [word for param in command.params if isinstance(param, click.Option)
               and param.required and values.get(str(param.name)) is None
               for word in (param.opts[0], str(param.metavar))]
    typed = shlex.join([*(exchanged.get(word, word) for word in words), *missing])
    raise TermselError("the folder of the result comes first, then the file", file=file,
                       hint=f"Type termsel {typed}")


def _print_alone(command: click.Command) -> click.Command:
    """Return a built-in command during which nothing else prints on stdout.

    stdout is taken when the command is invoked, not for its help page.
    """
    invoke = command.invoke
    # A copy, as the command object is shared by all calls in this process.
    command = copy(command)

    def invoke_alone(ctx: click.Context) -> Any:
        take_stdout()
        return invoke(ctx)

    command.invoke = invoke_alone  # type: ignore[method-assign]
    return command


def _plugin_command(name: str) -> click.Command | None:
    """Return the command of a plugin by its name; None if no plugin has it.

    For a plugin that could not be loaded it is a command that shows why.
    """
    from termsel.plugins.registry import registry

    names = registry()
    for entry in names.entries("commands"):
        # A name that two plugins provide is answered by distribution:name.
        if entry.answers_to(name):
            return _blame_plugin(entry.object)
    for failure in names.failures("commands"):
        if failure.plugin == name:
            return _broken_command(name, str(failure))
    return None


def _blame_plugin(command: click.Command) -> click.Command:
    """Return a command of a plugin whose faults name the plugin; it may choose its exit code.

    The fault names the distribution and its version, so that nobody reports it to termsel.
    """
    invoke = command.invoke

    def invoke_or_blame(ctx: click.Context) -> Any:
        """Run the plugin's command; raise PluginFault for an exception that is the plugin's fault.

        TermselError, click's own exceptions and MemoryError pass, and so do the errors of a closed
        or full stdout.
        """
        try:
            return invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort, TermselError,
                MemoryError):
            raise
        except Exception as error:
            if _is_of_stdout(error):
                raise
            from termsel.core.isolation.faults import distribution_of, fault_of_error, package_of

            package = package_of(command.callback)
            failure = f"the command {command.name!r} of {distribution_of(package)} failed"
            raise fault_of_error(error, failure, package) from error

    command.invoke = invoke_or_blame  # type: ignore[method-assign]
    return command


def _broken_command(name: str, why: str) -> click.Command:
    """Return a command that explains why a plugin's command does not work."""
    def explain() -> None:
        """Raise TermselError, which says why the command is broken."""
        raise TermselError(f"the command {name!r} is broken: {why}",
                           hint="Report it to its author, or install another version.")

    # Whatever is typed after it, the answer is why the command is broken.
    return click.Command(
        name, callback=explain, help=f"This command is broken: {why}",
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True})


@click.group(
    cls=Commands, context_settings={"help_option_names": ["-h", "--help"]},
    epilog="`termsel plugins` lists the commands of further packages.")
@click.version_option(__version__, message="termsel %(version)s")
def cli() -> None:
    """Georeference images from control points and lines, with a tested accuracy.

    \b
    Examples:
      termsel example files && cd files
      termsel run --points gcps.csv --out result
      termsel report result
    """
