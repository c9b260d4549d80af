"""Messages for a command line that cannot be read: which option, what is wrong with it, a remedy.

click names types of Python ("5m is not a valid float range"); these name what the user can type.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

import click

from termsel.core.errors import first_names_in_words, likely_names

_NUMBER = re.compile(r"[+-]?\d+(\.\d*)?")
_WITH_UNIT = re.compile(r"([+-]?\d+(?:\.\d*)?)\s*([A-Za-z]+)")
_NOT_VALID = re.compile(r"'(.*)' is not a valid (integer|float)", re.DOTALL)
_OUTSIDE = re.compile(r"(\S+) is not in the range")
_NO_LIMIT = 1e8
"""A largest number from which on nobody reaches it."""

_EXTRA = re.compile(r"Got unexpected extra arguments? \((.*)\)", re.DOTALL)
_IS_FILE = re.compile(r"Directory '(.*)' is a file", re.DOTALL)
_IS_FOLDER = re.compile(r"File '(.*)' is a directory", re.DOTALL)
_LOST = re.compile(r"(?:Directory|File|Path) '(.*)' does not exist", re.DOTALL)


def usage_message(error: click.ClickException, words: Sequence[str] = ()) -> str:
    """Return the fault of a command line, what to type instead, and where the options are listed.

    `words` are those that were typed.
    """
    path = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else ""
    # A MissingParameter is a BadParameter as well, and so comes before it.
    if isinstance(error, click.MissingParameter):
        lines = _lines_on_missing(error)
    elif isinstance(error, click.NoSuchOption):
        lines = [_unknown_option_message(error, words)]
    elif isinstance(error, click.BadOptionUsage):
        lines = [_without_value(error)]
    elif isinstance(error, click.BadParameter) and error.param is not None:
        lines = [_bad_value(error, error.param)]
    else:
        lines = [_extra_words(error)]
    more = [f"All options: {path} {_help_option(error)}"] if path else []
    return "\n".join([f"Error: {lines[0]}", *lines[1:], *more])


def _help_option(error: click.ClickException) -> str:
    """Return the option of a command that lists all of its options."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    params = context.command.get_params(context) if context else ()
    options = {option for param in params for option in param.opts}
    return "--help-all" if "--help-all" in options else "--help"


def _lines_on_missing(error: click.MissingParameter) -> list[str]:
    """Return lines on a missing option or argument: what it is, and an example of the command.

    The example is the first in the help of the command, if there is one.
    """
    param = error.param
    if param is None or error.ctx is None:
        return [error.format_message()]
    name = param.metavar or param.human_readable_name
    about = ""
    if isinstance(param, click.Option):
        name = f"{param.opts[0]} {param.metavar or ''}".strip()
        first = _first_sentence(param)
        about = f": {first[:1].lower()}{first[1:]}" if first else ""
    path = error.ctx.command_path
    examples = [line.strip().removesuffix("\\").rstrip()
                for line in (error.ctx.command.help or "").splitlines()
                if line.strip().startswith(f"{path} ")]
    return [f"{name} is missing{about}.", *(f"For example: {line}" for line in examples[:1])]


def _first_sentence(option: click.Option) -> str:
    """Return the first sentence of an option's help, without its full stop."""
    return (option.help or "").partition(". ")[0].rstrip(".")


_EXCHANGES = re.compile(r"--set swapped=(?:xy|line-sample) exchanges them")


_OF_MANY = re.compile(r"Of many images, a file each: termsel compare --points '([^'\s]+)' "
                      r"--out DIR\.")


def hint_for(ctx: click.Context, hint: str | None) -> str | None:
    """Return the hint of an error, if any, in words that fit the command which it ended.

    Code that reads files for many commands advises --set swapped, which few commands have, and
    termsel compare for many files, which some commands take themselves.
    """
    if hint is not None and any(isinstance(param, click.Argument) and param.nargs == -1
                                for param in ctx.command.params) and ctx.info_name != "run":
        # The shell replaces the pattern, so that it stands without quotation marks.
        hint = _OF_MANY.sub(rf"Give its files: {ctx.command_path} \1.", hint)
    if hint is None or any("--set" in param.opts for param in ctx.command.params):
        return hint
    return without_set(hint)


def without_set(text: str) -> str:
    """Return a text with what to do in the file in place of `--set swapped`, for other commands."""
    return _EXCHANGES.sub("exchange the names of the two columns in the header of the file", text)


def _unknown_option_message(error: click.NoSuchOption, words: Sequence[str]) -> str:
    """Return the message for an unknown option, with the option that may be meant.

    Where none is near, it names the commands that have such an option, and all options of this
    command if they are few. `words` are those that were typed.
    """
    params = error.ctx.command.params if error.ctx is not None else ()
    name = error.option_name
    own = {option for param in params for option in param.opts}
    missing = f"there is no option {name}."
    meant = [f"--{other}" for other in _ALSO_CALLED.get(name.lstrip("-").replace("_", "-"), ())
             if f"--{other}" in own]
    # Another word for an option of this command comes before an option of some model or solver.
    if meant:
        return f"{missing} Did you mean {meant[0]}?"
    others = _commands_with(name, error.ctx)
    elsewhere = f" It belongs to termsel {first_names_in_words(others, 4)}." if others else ""
    if "--set" in own:
        key = name.lstrip("-").replace("-", "_")
        if key == "height" and "--dem" in own:
            return (f"{missing}{elsewhere} Heights of the points are the column z of their file; "
                    "points without heights get them from a raster: --dem FILE.")
        advice = _advice_of_set(key, _typed_value(name, words))
        if advice:
            return f"{missing}{elsewhere} {advice}"
    options = [max(param.opts, key=len) for param in params
               if isinstance(param, click.Option) and not param.hidden]
    # An option that another command has is not misspelt.
    near = _nearest_option(name, options, is_spelt_right=bool(others))
    if near:
        return f"{missing} Did you mean {near}?"
    listed = f" Known: {', '.join(options)}." if 0 < len(options) <= _MOST_OPTIONS else ""
    return f"{missing}{elsewhere}{listed}"


def _typed_value(option: str, words: Sequence[str]) -> str:
    """Return the value that was typed for an option, as a shell takes it; VALUE where none was."""
    for word, following in zip(words, [*words[1:], ""], strict=False):
        name, _, value = word.partition("=")
        if name == option:
            value = value or following
            return "VALUE" if not value or value.startswith("--") else shlex.quote(value)
    return "VALUE"


def _nearest_option(typed: str, options: Sequence[str], is_spelt_right: bool) -> str:
    """Return the option that is probably meant; "" if none is near.

    First comes an option for which `typed` is another word, then one of which it is the beginning,
    or that begins it, and at last one of similar spelling, unless `is_spelt_right`.
    """
    names = {option.lstrip("-"): option for option in options}
    word = typed.lstrip("-").replace("_", "-").lower()
    meant = [name for name in _ALSO_CALLED.get(word, ()) if name in names]
    # As in --out for --output, and the other way round.
    begun = [name for name in names if len(word) >= _LEAST_BEGUN
             and (name.startswith(word) or word.startswith(name))]
    alike = [] if is_spelt_right else get_close_matches(word, names, n=1, cutoff=_ALIKE)
    near = [*meant, *begun, *alike]
    return names[near[0]] if near else ""


def _commands_with(option: str, ctx: click.Context | None) -> list[str]:
    """Return the commands of termsel itself that have an option, other than the one of a context.
    """
    if ctx is None or ctx.parent is None or not option.startswith("--"):
        return []
    group = ctx.parent.command
    if not isinstance(group, click.Group):
        return []
    commands = {name: group.get_command(ctx.parent, name) for name in group.list_commands(ctx)}
    return [name for name, command in commands.items()
            if command is not None and name != ctx.info_name
            and any(option in param.opts for param in command.params)]


def _advice_of_set(key: str, value: str) -> str:
    """Return how an option is set that no command has: by --set, with the part it is of; or "".

    An option of a model, solver or criterion is refused without that part, so that the part is
    named with it. Options of data stand alone, and so do those that every search has.
    """
    from termsel.io.read import read_options
    from termsel.plugins.registry import registry
    from termsel.runs.request import DATA_OPTIONS, first_choices, owners_of_options
    from termsel.selection.solvers.budget import SEARCH_OPTIONS

    setting = f"--set {key}={value}"
    alone = {option.name for option in (*DATA_OPTIONS, *SEARCH_OPTIONS, *read_options())}
    of_camera = f"camera_{key}"
    if of_camera in alone:
        return f"Of a camera that is known: --set {of_camera}={value}."
    if key in alone:
        return f"Set it by {setting}."
    owners = owners_of_options()
    if key in owners:
        role, *names = owners[key]
        first, *without_heights = first_choices(role, names)
        others = "".join(f"; for points without heights, --{role} {name} {setting}"
                         for name in without_heights)
        return f"It is an option of the {role} {first}: add --{role} {first} {setting}{others}."
    for entry in registry().entries("problems"):
        if key in {option.name for option in entry.object.options}:
            return (f"It is an option of the problem {entry.name}: add --problem {entry.name} "
                    f"{setting}.")
    for entry in registry().entries("readers"):
        if key in {option.name for option in entry.object.declared_options}:
            return (f"It is an option of the format {entry.name}: add --format {entry.name} "
                    f"{setting}.")
    return ""


_ALSO_CALLED = {
    "map": ("vectors", "reference"), "roads": ("vectors",), "ortho": ("reference",),
    "epsg": ("crs",), "srs": ("crs",), "t-srs": ("crs",), "s-srs": ("crs",),
    "projection": ("crs",), "gcps": ("points",), "gcp": ("points",), "control": ("points",),
    "tr": ("res",), "resolution": ("res",), "gsd": ("res",), "pixel-size": ("res",),
    "force": ("overwrite",), "yes": ("overwrite",), "runs": ("seeds", "repeats"),
    "repeats": ("seeds",), "seed": ("seeds",), "elevation": ("dem",), "dsm": ("dem",),
    "dtm": ("dem",), "heights": ("dem",), "silent": ("quiet",), "folder": ("out",),
    "o": ("out", "output"), "n": ("count",), "resume": ("checkpoint",), "continue": ("checkpoint",),
    "format": ("to",)}
"""Options by how other programs call them."""

_ALIKE = 0.65
"""Share of matching characters from which on an option is taken for misspelt."""

_LEAST_BEGUN = 3
"""Characters from which on the beginning of a name shows it."""

_MOST_OPTIONS = 20
"""Options of a command that a message lists."""


def _without_value(error: click.BadOptionUsage) -> str:
    """Return the message for an option whose value is missing, or for a flag that has one."""
    name = error.option_name
    option = _option_of(error.ctx, name)
    if option is None:
        return error.format_message()
    if option.is_flag:
        return f"{name} takes no value."
    return f"{_values_missing(option)} Type {name} {_value_name(option)}."


def _values_missing(option: click.Option) -> str:
    """Return the message for an option that lacks its values."""
    if option.nargs > 1:
        return f"{option.opts[0]} takes {option.nargs} values."
    return f"{option.opts[0]} has no value."


def _option_of(ctx: click.Context | None, name: str) -> click.Option | None:
    """Return the option of a command that has a name, such as ``--size``; None if none has."""
    for param in ctx.command.get_params(ctx) if ctx is not None else ():
        if isinstance(param, click.Option) and name in (*param.opts, *param.secondary_opts):
            return param
    return None


def _value_name(option: click.Parameter) -> str:
    """Return how the help calls the value of an option."""
    return (option.metavar or option.type.name.upper().partition(" ")[0]).strip("[].")


_UNIT_OF_VALUE = {"METRES": "metres", "M": "metres", "PX": "px", "--height": "metres",
                  "--seconds": "seconds", "--timeout": "seconds"}
"""Units that options take, by how the help calls their values, or by their names."""

_FACTORS = {"metres": {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "m": 1.0, "km": 1e3},
            "seconds": {"ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60.0, "h": 3600.0},
            "px": {"px": 1.0, "pixel": 1.0, "pixels": 1.0}}
"""How many of the unit of an option each unit is that somebody may type."""


def _remedy_for_unit(name: str, param: click.Parameter, typed: str) -> str:
    """Return what to type for a number with a unit: the number in the unit of the option.

    Where it cannot be converted the remedy says what to do, or in which unit the option is.
    """
    unit = _UNIT_OF_VALUE.get(_value_name(param)) or _UNIT_OF_VALUE.get(name)
    match = _WITH_UNIT.fullmatch(typed)
    if unit is None or match is None:
        return f"Type a number without a unit; the help says what {name} counts."
    factor = _FACTORS[unit].get(match[2].lower())
    if factor is not None:
        return f"{name} is in {unit}: {float(match[1]) * factor:g}."
    # How large a pixel is nobody knows before the run: the user has to divide.
    lengths = _FACTORS["metres"]
    if unit == "px" and match[2].lower() in lengths:
        return f"{name} is in px: {typed} divided by the size of a pixel in {match[2]}."
    return f"{name} is in {unit}."


def _bad_value(error: click.BadParameter, param: click.Parameter) -> str:
    """Return the message for a value that an option cannot take.

    click says what is wrong in several forms, which are told apart by patterns: no number, a number
    out of range, none of some words, a file that is not there or a folder in its place. Each gets
    its remedy, with what to type; a number with a unit is converted.
    """
    name = param.opts[0] if isinstance(param, click.Option) else _value_name(param)
    message = error.message
    not_number = _NOT_VALID.match(message)
    if not_number:
        typed, kind = not_number.groups()
        # An option of several values takes the next words, whatever these are.
        if param.nargs > 1:
            return (f"{name} takes {param.nargs} numbers, and {typed!r} is not a number. "
                    f"Type {name} {_value_name(param)}: the numbers apart, in this order.")
        noun = "a whole number" if kind == "integer" else "a number"
        number = _NUMBER.match(typed)
        is_with_unit = number is not None and kind == "float"
        remedy = f"Type {name} {param.metavar or 'N'}."
        if is_with_unit:
            remedy = _remedy_for_unit(name, param, typed)
        return f"{name} is {typed!r}, which is not {noun}. {remedy}"
    outside = _OUTSIDE.match(message)
    if outside and isinstance(param.type, click.IntRange | click.FloatRange):
        return f"{name} is {outside[1].removesuffix('.0')}, expected {_range_in_words(param.type)}."
    if isinstance(param.type, click.Choice):
        typed_word = re.match(r"'([^']+)' is not", message)
        choices = list(map(str, param.type.choices))
        near = likely_names(typed_word[1], choices) if typed_word else []
        question = f" Did you mean {near[0]!r}?" if near else ""
        word = repr(typed_word[1]) if typed_word else "another word"
        listed = ", ".join(choices[:-1])
        if typed_word and typed_word[1].rstrip("s") == "format" and "readers" in choices:
            return "Formats are of two kinds: termsel list readers, or termsel list writers."
        if name == "KIND" and typed_word and typed_word[1].rstrip("s") == "plugin":
            return "Plugins are no kind of thing that they provide. termsel plugins lists them."
        return f"{name} is {word}, expected {listed} or {choices[-1]}.{question}"
    # Files come last: their messages begin with the word for what they should be.
    lost = _LOST.match(message)
    if lost:
        return f"{name} is {lost[1]!r}, which does not exist. Check the name and the folder."
    is_file = _IS_FILE.match(message)
    other_kind = is_file or _IS_FOLDER.match(message)
    if other_kind:
        kinds = "file, expected a folder" if is_file else "folder, expected a file"
        return f"{name} is {other_kind[1]!r}, which is a {kinds}. Type {name} {_value_name(param)}."
    return f"{name}: {message.rstrip('.')}. Type {name} {_value_name(param)}."


def _range_in_words(kind: click.IntRange | click.FloatRange) -> str:
    """Return the limits of a number in words; an upper limit from `_NO_LIMIT` on is left out."""
    noun = "a whole number" if isinstance(kind, click.IntRange) else "a number"
    limits = []
    if kind.min is not None:
        limits.append(f"{'above' if kind.min_open else 'of at least'} {kind.min:,.12g}")
    if kind.max is not None and kind.max < _NO_LIMIT:
        limits.append(f"{'below' if kind.max_open else 'of at most'} {kind.max:,.12g}")
    return f"{noun} {' and '.join(limits)}"


def _extra_words(error: click.ClickException) -> str:
    """Return the message for words that a command does not take; other errors as they are."""
    extra = _EXTRA.match(error.message)
    ctx = error.ctx if isinstance(error, click.UsageError) else None
    if extra is None or ctx is None:
        return error.format_message()
    usage = " ".join(ctx.command.collect_usage_pieces(ctx))
    takes_words = any(isinstance(param, click.Argument) for param in ctx.command.params)
    remedy = "A name with spaces needs quotation marks." if takes_words else "Leave it out."
    file_options = [option.opts[0] for option in ctx.command.params
                    if isinstance(option, click.Option) and option.metavar == "FILE"
                    and option.opts[0] != "--output"]
    if Path(extra[1]).is_file() and file_options:
        remedy = f"Options that take a file: {', '.join(file_options)}."
    if any("--points" in param.opts for param in ctx.command.params):
        remedy = f"A file of points is given so: --points {shlex.quote(extra[1])}."
        if Path(extra[1]).is_dir():
            remedy = "It is a folder, and this command takes a file of points: --points FILE."
    # A command of a single TOML file, such as that of a block, does not take the tables of images.
    elif any(param.metavar.endswith(".toml") for param in ctx.command.params
             if isinstance(param, click.Argument) and param.metavar):
        remedy = (f"It takes one TOML file, which names all others: {ctx.command_path} --help "
                  "shows an example.")
    return f"{extra[1]!r} is more than this command takes: {ctx.command_path} {usage}. {remedy}"
