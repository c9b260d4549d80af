"""The words of the project: left-out words stay out."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from tests.lint.violations import Violation, code_files, line_at, pages, shown_files

_START, _END = r"(?<![a-z])", r"(?![a-z])"
# Underscores do not end a word in identifiers, so the ends are letters, not \b.
WORDS = {
    r"mend(s|ed|ing|able)?": "correct, fix",
    r"shar(e|es|ed|ing)[\s_]out": "assign",
    r"(bears?|borne)": "support, determine",
    r"dr(ive|ives|iven|ove)[\s_](it[\s_])?down": "minimised",
    r"(wrong|doubtful)[\s_](lines?|points?|features?|ones)": "blunder, outlier",
    r"sp(eak|eaks|oke)[\s_]of": "requires, contains",
    r"free[\s_]in[\s_]effect": "effective parameters",
    r"accurac(y|ies)[\s_]that[\s_]can[\s_]be[\s_]believed": "estimate, predicted RMSE",
}
TERMS = Path(__file__).parents[2] / "docs" / "reference" / "terms.md"
"""The page whose table has the field's term and, in its second column, those to avoid."""


def terms_to_avoid(page: str) -> Iterator[tuple[str, str]]:
    """Yield each term of the second column of a table, with the one to write instead."""
    for written, avoided in re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", page, re.MULTILINE):
        for term in avoided.split(", "):
            if avoided != "not":
                yield term, written


# Texts are broken over lines, comments and strings: between two words may stand all of these.
_BETWEEN = r"(?:[\s_#*>\"'-]|(?<=[\s\"'])[fr](?=[\"']))+"


def any_form(term: str) -> str:
    """Return a pattern of a term whose words are singular or plural, broken anywhere between."""
    forms = [re.escape(word.removesuffix("s") if len(word) > 3 else word) + "s?"
             for word in term.split()]
    return _BETWEEN.join(forms)


REFUSED = [(re.compile(f"{_START}{word}{_END}", re.IGNORECASE), instead)
           for word, instead in WORDS.items()]
REFUSED += [(re.compile(f"{_START}{any_form(term)}{_END}", re.IGNORECASE), written)
            for term, written in terms_to_avoid(TERMS.read_text(encoding="utf-8"))]
REFUSED.append((re.compile(
    r"\[(nano-)?pixels?\b|(?<![\w.])\d[\d,.]*[ -]pixels?\b|\}\s?pixels?\b|"
    r"\bin pixels\b|\bpixels? per\b", re.IGNORECASE), "px"))
# The option and field is code: the whole of a string, in backquotes, after a dot or before "=".
PROSE_POLISH = re.compile(r"""(?<![\w.`=/-])(?!(?<=["'])polish(ed)?["'])"""
                          r"polish(es|ed|ing)?(?![\w`=(])", re.IGNORECASE)
PARAMETER = re.compile(r"^[\w, ]+ : .*$", re.MULTILINE)  # as numpydoc declares them
# Public names that hold a left-out word: changing them would break callers.
NAMES = re.compile(r"\bwrong_lines\b|\bcheck-rmse\b")


def _blank(match: re.Match[str]) -> str:
    """Return what hides a match and keeps the lines and columns of what follows."""
    return re.sub(r"[^\n]", " ", match[0])


def _prose(path: Path, text: str) -> str:
    """Return what of a file is prose, in its lines: comments and strings, pages without code."""
    if path.suffix != ".py":
        # The marks stay, as a word right before or after them is code too.
        return re.sub(r"(?<=^```).*?(?=^```$)|(?<=`)[^`\n]+(?=`)", _blank, text,
                      flags=re.MULTILINE | re.DOTALL)
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", None)}
    lines: list[list[str]] = [[] for _ in range(text.count("\n") + 2)]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in kinds:
            for line, part in enumerate(token.string.split("\n"), token.start[0]):
                lines[line - 1].append(part)
    return "\n".join("\0".join(parts) for parts in lines)


def left_out_words(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Yield the line of every left-out word of a file, with the words to use instead."""
    text = NAMES.sub(_blank, text)
    for pattern, instead in REFUSED:
        for match in pattern.finditer(text):
            yield line_at(text, match.start()), f"{match[0]!r}: write {instead}"
    if "polish" in text.lower():  # taking a module apart into tokens is slow
        prose = PARAMETER.sub(_blank, _prose(path, text))
        for match in PROSE_POLISH.finditer(prose):
            yield line_at(prose, match.start()), f"{match[0]!r}: write local refinement"


def violations(root: Path) -> Iterator[Violation]:
    """Yield every left-out word below a root."""
    for path in (*code_files(root), *pages(root), *shown_files(root)):
        if path == TERMS or path.name == "CHANGELOG.md":  # which tells of earlier versions
            continue
        text = path.read_text(encoding="utf-8")
        for line, message in left_out_words(path, text):
            yield Violation(path, line, message)
