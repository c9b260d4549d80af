"""Errors a user can correct: what is wrong, where, and what to do about it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import SequenceMatcher, get_close_matches
from pathlib import PurePath
from traceback import TracebackException
from types import MappingProxyType

_JOINERS = frozenset("\u200c\u200d")
"""Joiners within words of some scripts."""

_SHOWN = frozenset(("Zs", "Co", "Cn"))
"""Categories that only Python calls not printable: spaces, private and newer characters."""

_LONGEST_MESSAGE, _LONGEST_HINT, _LONGEST_COLUMN = 1000, 5000, 100
"""Characters of each part of a message; a hint may list all formats."""


class TermselError(Exception):
    """Something the user can correct; the command line shows it and exits with code 2.

    Parameters
    ----------
    message : str
        What is wrong, as one sentence without a full stop.
    hint : str, optional
        What to do about it.
    file, line, column : optional
        Where: the file's name, the line counted from 1, the column's name or, of text without
        named columns, its number.
    ids : iterable of str, optional
        The features concerned, from which a reader finds the line of its file.
    name : str
        Of the option, model, solver or other thing that it is about, as far as there is one.
    code : str
        What is wrong, for programs, where one of them does something about it: "column-missing",
        "crs-unknown", "format-unknown", "ground-alone", "header-missing", "height-missing",
        "image-alone", "reference-missing", "rpc-alone", "text", or "model-unknown" and the like
        of any other kind of name. Messages may change their words, codes do not.

    Attributes
    ----------
    options : dict of str
        What options of the command could say instead, such as ``{"--crs": "EPSG:4979"}``; a "?" is
        for the user to complete.
    guesses : list of str
        Values of the option ``--columns`` that all fit, the one in `options` first, where nothing
        shows which of them is right.
    first_points : list of str
        The first point as each of these reads it, in words.

    Examples
    --------
    >>> import termsel
    >>> try:
    ...     termsel.run("no-such-problem")
    ... except termsel.TermselError as error:
    ...     print(error.what)
    unknown problem 'no-such-problem'
    """

    def __init__(
        self,
        message: str,
        *,
        hint: str | None = None,
        file: object = None,
        line: int | None = None,
        column: str | int | None = None,
        ids: Iterable[str] = (),
        name: str = "",
        code: str = "",
    ) -> None:
        super().__init__(message)
        self.what = message
        self.hint = hint
        self.file = file
        self.line = line
        self.column = column
        self.ids = tuple(ids)
        self.name = name
        self.code = code
        # Who finds out more while the error is on its way adds it to these.
        self.options: dict[str, str] = {}
        self.guesses: list[str] = []
        self.first_points: list[str] = []

    def __str__(self) -> str:
        """Return the message as it can be shown: printable, and long cells without their middle."""
        position = []
        if self.file is not None:
            position.append(make_printable(str(self.file), keep=""))
        if self.line is not None:
            position.append(f"line {self.line}")
        if isinstance(self.column, str):
            position.append(f"column {cut(self.column, _LONGEST_COLUMN)!r}")
        elif self.column is not None:
            position.append(f"column {self.column}")
        message = cut(self.what, _LONGEST_MESSAGE)
        text = ": ".join([", ".join(position), message]) if position else message
        end = "" if text.endswith(".") else "."  # of a library's message, or of a list cut short
        return make_printable(f"{text}{end} {cut(self.hint, _LONGEST_HINT)}" if self.hint else text)


def make_printable(text: str, keep: str = "\n\t") -> str:
    r"""Return text as a terminal can show it, whatever a file or a name brought.

    Other characters, which may control the terminal, are written as Python writes them, ``\x1b``;
    those in `keep` stay.
    """
    if text.isprintable():
        return text
    # Also marks of direction, and halves of characters.
    return "".join(char if char in keep or is_printable(char)
                   else char.encode("unicode_escape").decode("ascii") for char in text)


def is_printable(text: str) -> bool:
    """Return True for text without line breaks and what `make_printable` replaces."""
    return text.isprintable() or all(
        char.isprintable() or char in _JOINERS or unicodedata.category(char) in _SHOWN
        for char in text)


def cut(text: str, longest: int) -> str:
    """Return text without its middle if it has more characters than `longest`."""
    if len(text) <= longest:
        return text
    end = longest // 3
    return f"{text[:longest - end - 5]} ... {text[len(text) - end:]}"


MOST_NAMED = 40
"""Names a message lists before it stops."""

_MOST_MEANT = 3
"""Names that a message asks about at most."""

_OTHER_FIRST_LETTER = 0.75
"""Share of matching characters from which on a name is meant that begins with another letter."""

_ALIKE = 3
"""Letters at the beginning that show a name where no other begins with them."""

MOST_BESIDE_NEAR = 25
"""Names a message lists next to the nearest: of more, the nearest stands alone."""


PENDING = "termsel_pending"
"""Attribute of a log record that the command line keeps until a result, or an error, shows."""
ON_SUCCESS = "on success"
"""Value of it: of no interest where an error follows."""
DOUBT = "doubt"
"""Value of it: said by the summary of a run as well."""

ONCE = "termsel_once"
"""Attribute of a log record: what it is about; of many images the first alone gets the words."""

IMAGE = "termsel_image"
"""Attribute of a log record: the name of the image of many that it is about."""


_DEGREES = {"linear": 1, "quadratic": 2, "cubic": 3}
"""Degrees of polynomials by what the summary of a run calls them."""


_NUMBERED_DEGREE = re.compile(r"poly(?:nomial)?[ _-]?([1-8])")
"""Polynomials with the degree behind their name."""

_ALSO_NAMED = {
    "polynomial": ("poly2d", "poly3d"), "poly": ("poly2d", "poly3d"),
    "homography": ("projective2d",), "perspective": ("projective2d",),
    "similarity": ("helmert2d",), "conformal": ("helmert2d",), "helmert": ("helmert2d",),
    "rational": ("rfm",), "rpcs": ("rfm", "rpc"), "spline": ("tps",), "rubber-sheet": ("tps",),
    "thin-plate-spline": ("tps",), "thin_plate_spline": ("tps",), "kriging": ("field",),
    "gaussian-process": ("field",)}
"""Names of models by what other programs call them."""


def unknown_name_error(
        kind: str, name: str, names_known: Iterable[str], hint: str = "",
        summaries: Mapping[str, str] = MappingProxyType({})) -> TermselError:
    """Return the error for a name that is not among the known names of its kind.

    Its hint asks whether one of up to three similar names was meant, lists up to `MOST_NAMED` known
    ones unless there is a similar name among very many, and ends with `hint`. Where no name is
    similar, those are meant whose `summaries` have the word, as the genetic algorithm is called ga.
    For the degree of a polynomial, such as cubic, the hint names the model and its option instead.
    """
    names = sorted(set(names_known))
    elsewhere = [meant for meant in _ALSO_NAMED.get(name.lower(), ()) if meant in names]
    similar_names = (elsewhere or likely_names(name, names)
                     or _names_by_word(name, summaries))
    # The summary calls polynomials by their degree, such as cubic, which is no name of a model.
    numbered = _NUMBERED_DEGREE.fullmatch(name.lower())
    degree = numbered[1] if numbered else _DEGREES.get(name.lower())
    if degree is not None and "poly2d" in names:
        hint = (f"Name it poly2d, or poly3d with heights, and --set degree={degree}. "
                f"{hint}").rstrip()
        similar_names = []
    question = f"Did you mean {' or '.join(map(repr, similar_names))}?" if similar_names else ""
    if not names:
        listed = f"No {kind} is known here: leave it out."
    elif (similar_names or numbered) and len(names) > MOST_BESIDE_NEAR:
        listed = ""
    else:
        remainder = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        listed = f"Known: {', '.join(names[:MOST_NAMED])}{remainder}."
    return TermselError(f"unknown {kind} {name!r}", name=name, code=f"{kind}-unknown",
                        hint=" ".join(text for text in (question, listed, hint) if text))


def likely_names(name: str, names: Sequence[str]) -> list[str]:
    """Return up to three names that may be meant: the nearest, and those that differ by words.

    Without any, those whose letters were exchanged, else the only name of one word with the same
    first letters, such as population for "popsize". Upper and lower case count as the same.
    """
    by_small_letters = {known.lower(): known for known in names}
    small = name.lower()
    # Above 0.6 of matching characters a name with the same first letter is a misspelling, and one
    # with another above 0.75, as those of image are half of ridge's; below, any guess misleads.
    near = [known for known in get_close_matches(small, by_small_letters, n=3, cutoff=0.6)
            if known[:1] == small[:1]
            or SequenceMatcher(None, known, small).ratio() > _OTHER_FIRST_LETTER][:1]
    near += [known for known in by_small_letters if known not in near
             and (known.startswith(f"{small}-") or small.startswith(f"{known}-")
                  or known.endswith(f"-{small}"))]
    if not near:
        # Letters that were exchanged: dtl for dlt2d.
        near = [known for known in by_small_letters if known[:1] == small[:1]
                and sorted(known[:len(small)]) == sorted(small) and len(small) >= _ALIKE]
    alike = [known for known in by_small_letters if known[:_ALIKE] == small[:_ALIKE]
             and "-" not in known]
    if not near and len(alike) == 1 and len(small) > _ALIKE:
        near = alike
    return [by_small_letters[known] for known in near[:_MOST_MEANT]]


def _names_by_word(word: str, summaries: Mapping[str, str]) -> list[str]:
    """Return up to three names whose summaries have a word, those that begin like it first.

    A word of more than three summaries, such as image, means none that does not begin like it.
    """
    if len(word) <= _ALIKE:
        return []
    as_word = re.compile(rf"\b{re.escape(word.replace('-', ' ').replace('_', ' '))}", re.IGNORECASE)
    names = [name for name, summary in summaries.items() if as_word.search(summary)]
    start = word[:_ALIKE].lower()
    alike = [name for name in names if name.lower().startswith(start)]
    others = [name for name in names if name not in alike]
    return [*alike, *(others if len(names) <= _MOST_MEANT else [])][:_MOST_MEANT]


def shown_value(value: object) -> str:
    """Return a value for a message: itself if it is short, else its type."""
    if isinstance(value, str | PurePath | int | float):
        return repr(value)
    return f"of the type {type(value).__name__}"


def exception_in_words(error: BaseException) -> str:
    """Return type and message of an exception in one line."""
    # Not str(error), which may itself raise in an exception of a plugin.
    message = str(TracebackException(type(error), error, None))
    return " ".join(f"{type(error).__name__}: {message}".split()).rstrip(": ")


def percent_text(share: float) -> str:
    """Return a share in per cent with two decimals, or two digits if these would be 0.00."""
    return f"{100 * share:.2f} %" if share >= 1e-3 else f"{100 * share:.2g} %"


def count_in_words(number: int, noun: str) -> str:
    """Return a number with its noun, which takes an s unless the number is 1."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def amount_in_words(number: int, noun: str = "") -> str:
    """Return a number with commas, and its noun; above 15 digits in short, as 1.2e37."""
    short = f"{number:,}" if number < 10**15 else f"{number:.1e}".replace("e+", "e")
    ending = "" if number == 1 else "s"
    return f"{short} {noun}{ending}" if noun else short


def first_names_in_words(names: Sequence[str], limit: int = 10) -> str:
    """Return the first names of a list, and how many more there are, such as "A, B and 3 more"."""
    unnamed = len(names) - limit
    return ", ".join(names[:limit]) + (f" and {unnamed:,} more" if unnamed > 0 else "")


@contextmanager
def require_import(needing: str, packages: str, install: str,
                   file: object = None) -> Iterator[None]:
    """Run a block of imports; raise TermselError if one fails.

    The message begins with `needing`, which has its verb, as in "charts require", and the names of
    the `packages`; its hint is to let pip install `install`.
    """
    try:
        yield
    except ImportError:
        several = " and " in packages
        verb = "are" if several else "is"
        pronoun = "them" if several else "it"
        raise TermselError(f"{needing} {packages}, which {verb} not installed", file=file,
                           hint=f"Install {pronoun}: pip install {install}.") from None


GIS = '"termsel[gis]"'
"""The extra of what reads rasters, vector files and reference systems."""


# How figures are rounded wherever people read them.

_TENTHS, _HUNDREDTHS, _DIGITS, _SMALLEST = 99.95, 9.995, 0.0995, 1e-4
"""From these sizes on a figure has no decimals, one, and two; a smaller one has two digits."""


def rounded_size_text(value: float) -> str:
    """Return a size in px or metres as text, with as many decimals on every screen and page.

    A size below 1 has two digits at least; one of hundreds has no decimals.

    Examples
    --------
    >>> [rounded_size_text(size) for size in (0.0123, 0.2483, 8.149, 14.31, 1041.2)]
    ['0.012', '0.25', '8.15', '14.3', '1,041']
    """
    size = abs(value)
    if size >= _TENTHS:
        return f"{value:,.0f}"
    if size >= _HUNDREDTHS:
        return f"{value:.1f}"
    if size >= _DIGITS:
        return f"{value:.2f}"
    # Two digits, also where the second is 0; none are known of 0 itself.
    return f"{value:#.2g}" if size >= _SMALLEST else f"{value:.2g}"


def interval_text(low: float, high: float, percent: float = 90.0) -> str:
    """Return an interval as the screens show it, such as ``[90 %: 0.22-0.29 px]``."""
    return f"[{percent:.0f} %: {rounded_size_text(low)}-{rounded_size_text(high)} px]"
