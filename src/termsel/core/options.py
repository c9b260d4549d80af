"""Typed, documented options of models, problems, solvers and criteria."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from operator import index
from typing import Any, ClassVar

from termsel.core.display import Glance
from termsel.core.errors import TermselError, shown_value, unknown_name_error
from termsel.core.isolation.calls import Check, Guarded
from termsel.core.isolation.parts import package_of_option

COUNT = 1_000_000
"""Most of what is counted, where an option has no limit of its own: more is a mistake of typing."""

MOST_RUNS = 100_000
"""Most seeds, or splits, of a study."""

SEED = 2**63 - 1
"""Greatest seed."""


def whole_seed(seed: Any) -> int:
    """Return a seed as an int of Python; raise TermselError for what is no seed."""
    try:
        whole = -1 if isinstance(seed, bool) else index(seed)
    except TypeError:
        whole = -1
    if not 0 <= whole <= SEED:
        raise TermselError(f"seed is {shown_value(seed)}, expected a whole number from 0 to "
                           f"{SEED:,}", hint="Give one, such as seed=1.", name="seed")
    return whole


_file: ContextVar[str] = ContextVar("file", default="")  # whose options are being resolved


@contextmanager
def options_of_file(file: object) -> Iterator[None]:
    """Refuse, during a block, values of options that no file may set.

    The options resolved in the block are those of `file`, such as a study or a result, which may
    come from a stranger; None stands for what a user typed or gave in Python. Every value of an
    option goes through `Option.parse`, which looks here.
    """
    # A context variable: other threads may read another file at the same time.
    token = _file.set("" if file is None else str(file))
    try:
        yield
    finally:
        _file.reset(token)


_TYPE_WORDS = {int: "whole number", float: "number", bool: "true | false", str: "text"}
_TRUE = {"true", "yes", "on", "1"}
_FALSE = {"false", "no", "off", "0"}


@dataclass(frozen=True)
class Option:
    """One setting, as ``--set name=value`` or as a keyword in Python.

    Parameters
    ----------
    name : str
        The key.
    default : object
        Its value if none is given; None where it is not set; `doc` says what then holds.
    doc : str
        One sentence: meaning, unit, source where there is one.
    type : type
        int, float, bool or str.
    minimum, maximum : float, optional
        Closed range of a number.
    choices : tuple of str
        The accepted values, if they are few.
    from_files : bool or tuple of str
        Whether studies, blocks, results and other files may set it; or the only values that they
        may give it. False for what names code: that do the command line and Python alone.
        No option names an output: outputs have names of their own within ``--out``.

    Examples
    --------
    >>> import termsel
    >>> termsel.Option("degree", 3, "degree of the polynomial", int, minimum=1).default
    3
    """

    name: str
    default: Any
    doc: str
    type: type = str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    from_files: bool | tuple[str, ...] = True

    def __post_init__(self) -> None:
        """Raise TermselError for a type other than int, float, bool and str."""
        if self.type not in _TYPE_WORDS:
            raise TermselError(f"option {self.name!r} has the type {self.type!r:.100}",
                               hint="Give int, float, bool or str.")

    @property
    def accepts(self) -> str:
        """The accepted values, in words."""
        if self.choices:
            return " | ".join(self.choices)
        kind = _TYPE_WORDS[self.type]
        if self.minimum is not None and self.maximum is not None:
            return f"{kind} from {_plain_number(self.minimum)} to {_plain_number(self.maximum)}"
        if self.minimum is not None:
            return f"{kind} of at least {_plain_number(self.minimum)}"
        if self.maximum is not None:
            return f"{kind} of at most {_plain_number(self.maximum)}"
        return kind

    @property
    def limits_files(self) -> str:
        """The limit of values from files, in words; "" where a file may give every value."""
        if self.from_files is True:
            return ""
        if self.from_files is False:
            return "not from files"
        return f"from files only {' | '.join(self.from_files)}"

    def _require_from_file(self, value: Any, file: str) -> None:
        """Raise TermselError for a value that `file`, whose options are resolved, may not give.

        A file may give the default of any option.
        """
        allowed = self.from_files
        is_listed = isinstance(allowed, tuple) and str(value) in allowed
        if allowed is True or value == self.default or is_listed:
            return
        values = f" but to {', '.join(allowed)}" if allowed else ""
        raise TermselError(
            f"a file may not set the option {self.name!r}{values}", file=file,
            hint="It is set on the command line (--set) or in Python alone.",
            name=self.name)

    def parse(self, value: Any) -> Any:
        """Return `value` in the option's type.

        Parameters
        ----------
        value : object
            A value of the type, or its text as typed on the command line. A list or tuple of names
            or numbers is their text, separated by commas.

        Raises
        ------
        TermselError
            If the value is not of the type, out of range or not one of the choices; or is one that
            the file that gives it may not set.
        """
        # None stands for "not given", which only such options accept.
        if value is None and self.default is None:
            return None
        # What a user types is not restricted; a file is that of `options_of_file`.
        if file := _file.get():
            self._require_from_file(value, file)
        wrong = TermselError(f"option {self.name!r} does not accept {value!r}",
                             hint=f"Accepted: {self.accepts}.", name=self.name)
        parsed: Any
        if self.type is bool:
            # Also from files and the command line, where everything is text.
            text = str(value).strip().lower()
            if text not in _TRUE | _FALSE:
                raise wrong
            return text in _TRUE
        if self.type is str:
            is_list = isinstance(value, list | tuple)
            parsed = ",".join(map(str, value)) if is_list else str(value)
        else:
            try:
                parsed = self._parse_number(value)
            except (TypeError, ValueError, OverflowError):
                raise wrong from None
            # Only NaN differs from itself; a bool would pass as 0 or 1.
            if isinstance(value, bool) or parsed != parsed or abs(parsed) == float("inf"):
                raise wrong
        if self.choices and str(parsed) not in self.choices:
            raise wrong
        if self.minimum is not None and parsed < self.minimum:
            raise wrong
        if self.maximum is not None and parsed > self.maximum:
            raise wrong
        return parsed

    def _parse_number(self, value: Any) -> float:
        """Return a value as a number of the option's type, which is int or float.

        An int, and the text of one in plain digits, is exact. Other text of a whole number, such as
        "1e3", is read as a float, and so has its 53 bits. Raises ValueError, TypeError or
        OverflowError if the value is no such number.
        """
        if self.type is float:
            return float(value)
        try:
            # Not by way of float, which has 53 bits: a seed may have 63.
            return int(value) if isinstance(value, str) else index(value)
        except (TypeError, ValueError):
            number = float(value)
            if number != int(number):
                raise ValueError(f"{value!r} is not a whole number") from None
            return int(number)


def _plain_number(bound: float) -> str:
    """Return a bound as people write it: 1,000,000 and not 1e+06, 2^63 - 1 and not 9.2e+18."""
    if bound == 2**63 - 1:  # the largest whole number of 64 bits
        return "2^63 - 1"
    return f"{bound:,.0f}" if 1e5 <= abs(bound) < 1e13 and bound == int(bound) else f"{bound:g}"


def options_by_part(values: Mapping[str, Any],
                    declared: Mapping[str, Iterable[Option]]) -> dict[str, dict[str, Any]]:
    """Return the values of options by part of a run and by name; a part may have none.

    `values` are given by name, or by ``part.name`` where several parts have an option of that name;
    `declared` has the options of each part. Raises TermselError for an option that no part has,
    that is given by name alone where several parts have it, or that is given twice.
    """
    # Several parts may have an option of one name, such as the seed of a problem and of a solver.
    owners: dict[str, list[str]] = {}
    for owner, options in declared.items():
        for option in options:
            owners.setdefault(option.name, []).append(owner)
    values_by_owner: dict[str, dict[str, Any]] = {owner: {} for owner in declared}
    for key, value in values.items():
        prefix, _, name = key.rpartition(".")
        # Without a part in front of its name an option belongs to whoever has it.
        matching = [owner for owner in owners.get(name, ()) if prefix in ("", owner)]
        if not matching:
            if of_package := package_of_option(name):
                raise TermselError(f"unknown option {key!r}", hint=of_package, name=key)
            raise unknown_name_error("option", key, owners)
        if len(matching) > 1:
            full_names = " or ".join(f"{owner}.{name}" for owner in matching)
            raise TermselError(f"{' and '.join(matching)} each have an option {name!r}",
                               hint=f"Write {full_names}.", name=name)
        owner = matching[0]
        if name in values_by_owner[owner]:
            raise TermselError(f"option {name!r} of the {owner} is given twice",
                               hint="Give it once.", name=name)
        values_by_owner[owner][name] = value
    return values_by_owner


def resolve(declared: Iterable[Option], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the value of every declared option, its default where none was set.

    Raises TermselError for an unknown option, and for a value that it does not take.
    """
    options = {option.name: option for option in declared}
    for key in values:
        if key not in options:
            raise unknown_name_error("option", key, options)
    return {name: option.parse(values.get(name, option.default))
            for name, option in options.items()}


def _by_position_message(cls: str, values: Sequence[object], names: Sequence[str]) -> str:
    """Return the message for options of a class that are given without their names."""
    if not names:
        return f"{cls} takes no options: write {cls}()."
    written = ", ".join(f"{name}={value!r:.60}" for name, value in zip(names, values, strict=False))
    return f"{cls} takes options by name alone: {cls}({written})."


class Configurable(Glance, Guarded):
    """A named thing with declared options; base of models, solvers and criteria.

    Parameters
    ----------
    **options
        Values of the options declared in `declared_options`.

    Raises
    ------
    TermselError
        For an unknown option or a value it does not accept.

    Examples
    --------
    >>> import termsel
    >>> termsel.Polynomial2D(degree=3).options["degree"]
    3
    """

    name: ClassVar[str]
    """As on the command line and in ``termsel list``."""

    declared_options: ClassVar[tuple[Option, ...]] = ()
    """The options it takes, which ``termsel describe`` shows."""

    guards: ClassVar[Mapping[str, Check | None]] = {"__init__": None}

    def __init__(self, *values: object, **options: Any) -> None:
        if values:
            raise TypeError(_by_position_message(type(self).__name__, values, [
                option.name for option in self.declared_options]))
        self.options: dict[str, Any] = resolve(self.declared_options, options)
        """The value of every declared option."""

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        return f"{type(self).__name__}: {self.name}", {
            name: str(value) for name, value in self.options.items()}
