"""One self-contained page that opens offline: sections of text, charts and tables.

The page asks for nothing from elsewhere, which its Content-Security-Policy enforces: only the
scripts and the style with the given checksums, and pictures in the page itself. Charts are
evaluated by an interpreter, as the policy allows no code made from text.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby
from typing import Any

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
from termsel.results.library import read_library
from termsel.results.pictures import make_drawable
from termsel.results.theme import dark_style, with_theme

_OPTION = re.compile(r"--[a-z][\w-]*")

MOST_COLUMNS = 7
"""Of a table on a narrow screen; one with more has its cells one below the other there."""


def render_page(document: Document) -> str:
    """Return the document of a result or a study as a page of HTML.

    Raises
    ------
    TermselError
        If altair or vl-convert-python is not installed.
    """
    specs: dict[str, Any] = {}
    title = document.title
    content_blocks = list(_blocks_html(document.facts, specs))
    for number, section in enumerate(document.sections, 1):
        content = "\n".join(_blocks_html(section.blocks, specs))
        content_blocks.append(f'<section aria-labelledby="s{number}"><h2 id="s{number}">'
                              f"{_escape_html(section.title)}</h2>\n{content}\n</section>")
    style = _read_resource("page.css") + dark_style()
    script = _read_resource("page.js")
    # Nothing from elsewhere is loaded, and no script runs but these two, known by their checksums.
    drawing = read_library()
    policy = (f"default-src 'none'; script-src {_checksum_of(drawing)} {_checksum_of(script)}; "
              f"style-src {_checksum_of(style)}; img-src data:; base-uri 'none'; form-action "
              "'none'")
    # Nothing in a block of data may end it.
    charts = json.dumps(_share_data(specs), separators=(",", ":"), allow_nan=False)
    charts = make_drawable(charts).replace("<", "\\u003c")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{_escape_html(title)}</title>
<style>{style}</style>
</head>
<body>
<header><h1>{_escape_html(title)}</h1><p>{_escape_html(document.subtitle)}</p></header>
<main>
{chr(10).join(content_blocks)}
</main>
<p id="chosen" role="status" aria-live="polite"></p>
<script type="application/json" id="charts">{charts}</script>
<script>{drawing}</script>
<script>{script}</script>
</body>
</html>
"""


def _share_data(specs: dict[str, Any]) -> dict[str, Any]:
    """Return charts that name their data, under "charts", and all data once, under "data".

    Charts share much of their data. `specs` are Vega-Lite specifications by the name of the chart.
    """
    data: dict[str, Any] = {}
    charts = {}
    for name, spec in specs.items():
        data |= spec.get("datasets", {})
        charts[name] = {**spec, "datasets": list(spec.get("datasets", ()))}
    return {"data": data, "charts": charts}


def _blocks_html(blocks: Iterable[Block], specs: dict[str, Any]) -> Iterator[str]:
    """Yield blocks as HTML; charts in a row share it where there is room.

    The specifications of charts are added to `specs`.
    """
    for kind, group in groupby(blocks, type):
        if kind is Fact:
            yield _facts_html([block for block in group if isinstance(block, Fact)])
            continue
        content = "\n".join(_block_html(block, specs) for block in group)
        yield f'<div class="figures">{content}</div>' if kind is Figure else content


def _facts_html(facts: Sequence[Fact]) -> str:
    """Return the lines of the first screen: those without a label as text, others as a list."""
    paragraphs = [f"<p>{_prose_html(fact.text)}</p>" for fact in facts if not fact.label
                  and fact.text]
    rows = [f"<dt>{_escape_html(fact.label.strip())}</dt><dd>{_prose_html(fact.text)}</dd>"
            for fact in facts if fact.label]
    listed = f'<dl class="facts">{"".join(rows)}</dl>' if rows else ""
    return "\n".join([*paragraphs, listed])


def _block_html(block: Block, specs: dict[str, Any]) -> str:
    """Return a block as HTML, with all text escaped.

    The specification of a chart goes into `specs`, by the name of the chart: the page has all of
    them at its end.
    """
    if isinstance(block, Detail):
        return _block_html(block.block, specs)
    if isinstance(block, str):
        return f"<p>{_prose_html(block)}</p>"
    if isinstance(block, Note):
        return f"<p><strong>{_escape_html(block.label)}:</strong> {_prose_html(block.text)}</p>"
    if isinstance(block, Fact):
        return _facts_html([block])
    if isinstance(block, Names):
        return (f"<details><summary>{_escape_html(block.title)}: {len(block.names)}</summary>"
                f"<p>{_escape_html(' '.join(block.names))}</p></details>")
    if isinstance(block, Statement):
        return f'<blockquote class="statement" tabindex="0">{_escape_html(block.text)}</blockquote>'
    if isinstance(block, Code):
        return f'<pre tabindex="0"><code>{_escape_html(block.text)}</code></pre>'
    return _chart_as_html(block, specs) if isinstance(block, Figure) else _table_as_html(block)


def _chart_as_html(figure: Figure, specs: dict[str, Any]) -> str:
    """Return an empty element for a chart as HTML, and put the chart's specification into `specs`.

    The browser draws it there from its specification, which is at the end of the page.
    """
    specs[figure.name] = with_theme(figure.chart).to_dict()
    ratio = figure.chart.width / figure.chart.height if figure.keeps_ratio else 0
    return (f'<figure id="{_escape_html(figure.name)}"><h3>{_escape_html(figure.title)}</h3>'
            f"<p class=\"look\">{_escape_html(figure.look)}</p>"
            f'<div class="chart" data-chart="{_escape_html(figure.name)}" data-ratio="{ratio:.4g}" '
            f'role="group" aria-label="{_escape_html(figure.title)}"></div></figure>')


def _table_as_html(table: TableBlock) -> str:
    """Return a table as HTML."""
    # The first column is the head of its row, which has a style of its own.
    classes = ["", *(_column_class(table, i) for i in range(1, len(table.columns)))]
    heads = [f'<th scope="col"{column_class}>{_escape_html(name)}</th>' if name else "<td></td>"
             for name, column_class in zip(table.columns, classes, strict=True)]
    if table.pictures:
        heads.insert(1, '<th scope="col" class="words">residuals</th>')
    choice = f' data-choice="{_escape_html(table.choice)}"' if table.choice else ""
    # A table with text beside numbers, or with many columns, is wider than a narrow screen, which
    # shows it as a list.
    is_listed = bool(table.pictures or ' class="words"' in classes
                     or sum(column != ' class="beyond"' for column in classes) > MOST_COLUMNS)
    listed = ' class="listed"' if is_listed else ""
    rows = [_row_html(table, i, classes, is_listed) for i in range(len(table.rows))]
    caption = _escape_html(table.caption)
    table_html = (f'<div class="scroll" tabindex="0"><table{listed}{choice}><caption><span>'
                  f"{caption}</span></caption><thead><tr>{''.join(heads)}</tr></thead><tbody>\n"
                  + "\n".join(rows) + "\n</tbody></table></div>")
    if table.folded:
        return f"<details><summary>{caption}</summary>{table_html}</details>"
    return table_html


def _column_class(table: TableBlock, column: int) -> str:
    """Return the class of the cells of a column, as an attribute of HTML.

    Returns "" for a column that needs no class.
    """
    if table.has_words(column):
        return ' class="words"'
    if column in table.page_only:  # too wide for a narrow screen as for a text
        return ' class="beyond"'
    if table.columns[column].endswith("interval"):
        return ' class="range"'
    return ' class="names"' if _has_names(table, column) else ""


def _has_names(table: TableBlock, column: int) -> bool:
    """Return whether a column has words alone, such as roles, which begin at the left."""
    text = "".join(row[column] for row in table.rows)
    return any(letter.isalpha() for letter in text) and not any(map(str.isdigit, text))


def _row_html(table: TableBlock, i: int, classes: Sequence[str], is_listed: bool) -> str:
    """Return row i of a table as HTML: its head, which may be a button that picks it, and cells.

    `classes` are those of the columns; with `is_listed` each cell names its column, for narrow
    screens, which show rows as lists.
    """
    name, *texts = map(_escape_html, table.rows[i])
    attributes = ' class="marked"' if i == table.marked else ""
    if table.choice:
        attributes += f' data-key="{_escape_html(make_drawable(json.dumps(table.keys[i])))}"'
        name = f'<button type="button">{name}</button>'
    picture = f'<td class="picture">{table.pictures[i]}</td>' if table.pictures else ""
    heads = [f' data-head="{_escape_html(head)}"' if is_listed and head else ""
             for head in table.columns[1:]]
    cells = [f"<td{column_class}{head}>{text}</td>"
             for text, head, column_class in zip(texts, heads, classes[1:], strict=True)]
    return f'<tr{attributes}><th scope="row">{name}</th>{picture}{"".join(cells)}</tr>'


def _escape_html(text: str) -> str:
    """Return text of names and files as HTML, in which no markup or control sign has an effect."""
    return escape(make_printable(text))


def _prose_html(text: str) -> str:
    """Return a sentence as HTML, in which no option is broken at its hyphens."""
    return _OPTION.sub(r'<span class="whole">\g<0></span>', _escape_html(text))


def _read_resource(name: str) -> str:
    """Return the text of a file that lies next to this module."""
    return (files("termsel.results") / name).read_text(encoding="utf-8")


def _checksum_of(text: str) -> str:
    """Return the SHA-256 of a script or style as a content security policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
