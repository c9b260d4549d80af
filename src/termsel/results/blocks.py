"""What people read, as blocks: text and pages render the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

_LONGEST_NUMBER = 24
"""Characters beyond which a cell of a table is words, and begins at the left."""


@dataclass(frozen=True)
class Note:
    """What else a reader must know, or a fact behind its label.

    Parameters
    ----------
    text, label : str
        What is said, and what stands before it.

    Examples
    --------
    >>> import termsel
    >>> termsel.Note("Two points share one position.").label
    'Note'
    """

    text: str
    label: str = "Note"


@dataclass(frozen=True)
class Fact:
    """A line of the first screen.

    Parameters
    ----------
    text, label : str
        What is said, and the word in front of it: a blank where the line goes on from the one
        above, nothing where the line stands alone.
    """

    text: str
    label: str = ""


@dataclass(frozen=True)
class Statement:
    """A statement that can be pasted elsewhere as it is."""

    text: str


@dataclass(frozen=True)
class Code:
    """A command, or other text in which spaces count.

    Parameters
    ----------
    text : str
        Shown as it is, line by line.

    Examples
    --------
    >>> import termsel
    >>> termsel.Code("termsel report result").text
    'termsel report result'
    """

    text: str


@dataclass(frozen=True)
class Names:
    """A list of names, such as those of terms, with what they have in common."""

    title: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class TableBlock:
    """A table, which also serves where a chart cannot be seen.

    Parameters
    ----------
    caption, columns, rows
        Numbers are text, already rounded.
    choice, keys
        Name of the choice that a row makes in the charts, if any; what each row chooses, or is of.
    folded : bool
        Whether it is shown only when asked for; a text leaves it out.
    pictures, marked
        A drawing of each row as SVG, if any, and the row that was chosen.
    page_only : tuple of int
        Columns that a text leaves out, as they are too wide for it.

    Examples
    --------
    >>> import termsel
    >>> termsel.TableBlock("Errors", ("point", "error [px]"), [("P1", "0.4")]).columns
    ('point', 'error [px]')
    """

    caption: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    choice: str = ""
    keys: Sequence[Any] = ()
    folded: bool = False
    pictures: Sequence[str] = ()
    marked: int | None = None
    page_only: tuple[int, ...] = ()

    def has_words(self, column: int) -> bool:
        """Return whether a column has words, which begin at the left, and not numbers."""
        # A table is aligned by its longest cell; ids are names unless all are numbers.
        return any(len(row[column]) > _LONGEST_NUMBER for row in self.rows) or (
            column == 0 and not all(row[0].isdigit() for row in self.rows))


@dataclass(frozen=True)
class Figure:
    """A chart with what to look for; a text leaves it out."""

    name: str
    title: str
    look: str
    chart: Any  # of Altair, without title and style
    keeps_ratio: bool = False  # whether height follows width, as that of a map


@dataclass(frozen=True)
class Detail:
    """What a short text leaves out."""

    block: Block


Block = str | Note | Fact | Detail | Statement | Code | Names | TableBlock | Figure
"""A block; text alone is a paragraph."""


@dataclass(frozen=True)
class Section:
    """A heading, such as a question, and what follows it."""

    title: str
    blocks: tuple[Block, ...] = ()


@dataclass(frozen=True)
class Document:
    """What is shown of a result or a study."""

    title: str
    subtitle: str
    facts: tuple[Block, ...]  # what stands before the first heading
    sections: tuple[Section, ...]
