"""Short answers of the index of evidence state figures of their pages."""

from __future__ import annotations

import re

import pytest

from tests.docs.test_evidence_pages import PAGES

MOST_ROWS = 28
"""Of a table that sums up; in longer ones, of single sets, almost any figure is found. Their rows
of all sets count."""
FIGURE = re.compile(r"(?<![\w.,:/-])\d[\d,]*(?:\.\d+)?(?![\w-])")
LONG_TABLE = re.compile(rf"^\|.*\n\| ?:?-.*\n(?:\|.*\n){{{MOST_ROWS + 1},}}", re.MULTILINE)


def figures_in(text: str) -> list[str]:
    """Return the numbers of a text without commas, as they are written."""
    return [number.replace(",", "") for number in FIGURE.findall(re.sub(r"\]\([^)]*\)", "", text))]


def answers() -> dict[str, str]:
    """Return the question and the short answer of each page in the index."""
    index = (PAGES / "index.md").read_text(encoding="utf-8")
    return {page: f"{question} {answer}" for page, question, answer in re.findall(
        r"^\| \[[^]]*\]\(([\w-]+)\.md\) \| (.*) \| (.*) \|$", index, re.MULTILINE)}


def is_stated(figure: str, stated: list[str]) -> bool:
    """Return whether a figure is among those of a page, rounded as it is."""
    decimals = len(figure.partition(".")[2])
    return any(len(one.partition(".")[2]) >= decimals
               and abs(float(one) - float(figure)) <= 0.5001 * 10.0**-decimals for one in stated)


@pytest.mark.parametrize("page", answers())
def test_a_short_answer_has_the_figures_of_its_page(page: str) -> None:
    text = LONG_TABLE.sub(
        lambda table: "\n".join(re.findall(r"^\| all .*$", table[0], re.MULTILINE)),
        (PAGES / f"{page}.md").read_text(encoding="utf-8"))
    stated = figures_in(text)
    assert [one for one in figures_in(answers()[page]) if not is_stated(one, stated)] == []


def test_another_figure_than_that_of_the_page_is_found() -> None:
    assert len(answers()) > 30
    assert figures_in("1,167 runs in [ten](page-10.md), -0.27 (0.97 to 1.073)") == [
        "1167", "0.97", "1.073"]
    assert is_stated("1.02", ["1.019"])
    assert not is_stated("1.02", ["1.04", "1.0", "10.2"])
