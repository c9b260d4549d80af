"""Blocks as text, for a terminal and for files."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence

from termsel.core.errors import make_printable
from termsel.results.blocks import (
    Block,
    Code,
    Detail,
    Document,
    Fact,
    Figure,
    Names,
    Note,
    Statement,
    TableBlock,
)

_WIDTH = 88
_LONGEST_TABLE = 40
"""Rows of a table; of a longer one there is only their number."""
_WIDEST_COLUMN = 60
_LABEL = 10
"""Characters of the column of labels on the first screen."""


def text_of(document: Document, *, with_details: bool = True, titled: bool = True) -> str:
    """Return the document of a result or a study as text.

    `titled` is whether it begins with the title, and not with the facts. `with_details` is whether
    it has what --verbose adds, the blocks of `Detail`. Figures have no text.
    """
    lines = [document.title, *_wrap_text(document.subtitle)] if titled else []
    lines += _lines_of_blocks(_blocks_shown(document.facts, with_details))
    for section in document.sections:
        if blocks := list(_blocks_shown(section.blocks, with_details)):
            lines += ["", section.title, *_lines_of_blocks(blocks)]
    # File names may have what a terminal would obey.
    return make_printable("\n".join(lines)) + "\n"


def text_of_blocks(blocks: Iterable[Block], *, all_rows: bool = False) -> str:
    """Return blocks as text, such as the facts of the first screen.

    Of long tables it has `all_rows`, or only their number.
    """
    return make_printable("\n".join(_lines_of_blocks(blocks, all_rows=all_rows))) + "\n"


def _blocks_shown(blocks: Iterable[Block], with_details: bool) -> Iterator[Block]:
    """Yield the blocks that a text shows."""
    for block in blocks:
        if isinstance(block, Detail):
            yield from _blocks_shown([block.block] if with_details else [], with_details)
        elif not (isinstance(block, Figure) or (isinstance(block, TableBlock) and block.folded)):
            yield block


def _lines_of_blocks(blocks: Iterable[Block], *, all_rows: bool = False) -> Iterator[str]:
    """Yield the lines of blocks, with an empty one around each table and each piece of code.

    With `all_rows` tables are not cut. A fact has its label in a column of its own; all but code
    and tables is wrapped to the width of a terminal. What is for a page alone, such as a chart, is
    left out.
    """
    after_table = False
    for i, block in enumerate(blocks):
        is_table = isinstance(block, TableBlock | Code)
        if i and (after_table or is_table):
            yield ""
        after_table = is_table
        if isinstance(block, TableBlock):
            yield from _lines_of_table(block, all_rows=all_rows)
        elif isinstance(block, Note):
            yield from _wrap_text(f"{block.label}: {block.text}", 4)
        elif isinstance(block, Fact) and block.label:
            yield from textwrap.wrap(block.text, _WIDTH, initial_indent=block.label.ljust(_LABEL),
                                     subsequent_indent=" " * _LABEL, break_on_hyphens=False)
        elif isinstance(block, Fact):
            # A fact without text is an empty line on purpose.
            yield from _wrap_text(block.text, 4) or [""]
        elif isinstance(block, Names):
            yield from _wrap_text(f"{block.title}: {' '.join(block.names)}", 2)
        elif isinstance(block, Code):
            yield from block.text.splitlines()
        elif isinstance(block, str | Statement):
            yield from _wrap_text(block if isinstance(block, str) else block.text)


def _lines_of_table(table: TableBlock, *, all_rows: bool) -> Iterator[str]:
    """Yield the lines of a table: its caption, its header and its rows.

    Columns that are for a page only are left out, and an arrow is before the row that is marked.
    Of a table of more than _LONGEST_TABLE rows only their number is told, unless `all_rows`.
    """
    if table.caption:
        yield table.caption
    if len(table.rows) > _LONGEST_TABLE and not all_rows:
        yield f"{len(table.rows)} rows; result.json has all of them"
        return
    columns = [i for i in range(len(table.columns)) if i not in table.page_only]
    rows = [[row[i] for i in columns] for row in (table.columns, *table.rows)]
    lines = list(_align_rows(rows, map(table.has_words, columns)))
    # Rows are counted without the header, which is the first line.
    if table.marked is not None:
        lines = [("-> " if i == table.marked + 1 else "   ") + line
                 for i, line in enumerate(lines)]
    yield from lines


def _align_rows(rows: Sequence[Sequence[str]], are_words: Iterable[bool]) -> Iterator[str]:
    """Yield rows as lines of columns: words begin at the left, numbers end at the right.

    `are_words` says of each column whether it has words.
    """
    # As wide as the widest cell, but a list of names in one row would push the others away.
    widths = [min(max(map(len, column)), _WIDEST_COLUMN) for column in zip(*rows, strict=True)]
    are_words = list(are_words)
    for row in rows:
        cells = [cell.ljust(width) if words else cell.rjust(width)
                 for cell, width, words in zip(row, widths, are_words, strict=True)]
        yield "  ".join(cells).rstrip()


def _wrap_text(text: str, indent: int = 0) -> list[str]:
    """Return the lines of a text, wrapped to the width of a screen."""
    return textwrap.wrap(text, _WIDTH, subsequent_indent=" " * indent, break_on_hyphens=False)
