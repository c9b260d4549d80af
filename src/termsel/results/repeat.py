"""The command that repeats a run."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator
from itertools import chain

from termsel.data.record.figures import Value, as_plain_data
from termsel.data.record.record import Record
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import GIVEN


def repeating_command(record: Record) -> str:
    """Return the command that repeats a run in the folder of its result.

    The points and lines there have their roles, heights and the size of their image, and the record
    has the vendor's RPC, so that the files they came from are not needed. For some runs there is no
    such command: `reason_for_no_command` says why, and is asked first.
    """
    return " \\\n    ".join(["termsel run", *_command_arguments(record)])


def reason_for_no_command(record: Record) -> str:
    """Return why no command repeats a run; "" if one does."""
    own_classes = [f"{role} {plugin.class_}" for role, plugin in record.plugins.items()
                   if plugin.class_]
    if own_classes:
        return (f"No command repeats this run, as no plugin provides its {', '.join(own_classes)}. "
                "Call termsel.run with the same objects, seed and options.")
    if record.solver == GIVEN:
        return "No command repeats this result, as its genes were given in Python."
    return ""


def _command_arguments(record: Record) -> Iterator[str]:
    """Yield the arguments of the command that repeats a run.

    Data are the files in the result's own folder, with the roles as they were, so that the command
    repeats the same run elsewhere. Only what differs from the problem's own parts and options is
    named.
    """
    counts = record.data.counts
    yield f"--problem {shlex.quote(_full_name(record, 'problem'))}"
    if counts.control or counts.check or counts.independent or counts.off:
        yield "--points points.csv"
    if counts.lines:
        yield "--lines lines.csv"
    yield f"--crs {shlex.quote(record.data.crs)}"
    if record.data.rpc is not None:
        yield "--rpc result.json"
    if record.strategy:
        yield "--strategy auto"
    else:
        # A solver that a command names takes the options of its paper; the default one that a
        # problem brings has some of them open, as None.
        is_named = record.solver != Recipe.solver or None not in record.options.solver.values()
        for part_of_run in ("model", "solver", "criterion") if is_named else ("model", "criterion"):
            yield f"--{part_of_run} {shlex.quote(_full_name(record, part_of_run))}"
    yield from _settings_of_run(record)
    yield f"--seed {record.seed}"
    for name, limit in as_plain_data(record.budget).items():
        yield f"--{name} {limit:.12g}"


def _settings_of_run(record: Record) -> Iterator[str]:
    """Yield the options of all parts of the run but those that follow from other arguments."""
    options_by_owner = as_plain_data(record.options)
    owners = Counter(chain.from_iterable(options_by_owner.values()))
    for owner, options in options_by_owner.items():
        # What is chosen automatically has no options but those of the data.
        if record.strategy and owner != "data":
            continue
        for name, value in options.items():
            is_settled = owner == "data" and name in _SETTLED
            if value is None or is_settled or (owner, name) == _OF_PROOF:
                continue
            # A name that two parts have must say which.
            key = f"{owner}.{name}" if owners[name] > 1 else name
            yield f"--set {shlex.quote(f'{key}={_value_text(value)}')}"


def _full_name(record: Record, part_of_run: str) -> str:
    """Return the name of a part, with its distribution if a plugin provides it."""
    plugin = record.plugins.get(part_of_run)
    return str(getattr(record, part_of_run)) if plugin is None else plugin.name


_OF_PROOF = ("solver", "certificate")
"""Option that changes nothing of the run, and needs a folder."""

_SETTLED = ("roles", "off", "role", "fractions", "split")
"""Options of data that the roles in points.csv have settled."""


def _value_text(value: Value) -> str:
    """Return a value as it is typed: true and false in small letters."""
    return str(value).lower() if isinstance(value, bool) else str(value)
