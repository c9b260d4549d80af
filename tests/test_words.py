"""The words of the project: left-out words stay out, and sentences for users stay short."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CODE = sorted(path for folder in ("src", "plugins", "benchmarks")
              for path in (ROOT / folder).rglob("*.py") if "tests" not in path.parts)
PAGES = sorted(path for path in [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(ROOT / "docs").rglob("*.md"), *(ROOT / "plugins").rglob("*.md")]
    if "_build" not in path.parts)
LONGEST = 25
"""Words of a sentence for users."""

_START, _END = r"(?<![a-z])", r"(?![a-z])"
# Underscores do not end a word in identifiers, so the ends are letters, not \b.
WORDS = {
    r"mend(s|ed|ing|able)?": "correct, fix",
    r"besides?": "next to, compared with",
    r"shar(e|es|ed|ing)[\s_]out": "assign",
    r"(bears?|borne)": "support, determine",
    r"dr(ive|ives|iven|ove)[\s_](it[\s_])?down": "minimised",
    r"(wrong|doubtful)[\s_](lines?|points?|features?|ones)": "blunder, outlier",
    r"doubtful": "blunder, outlier",
    r"anew": "again, or the verb with re-",
    r"sp(eak|eaks|oke)[\s_]of": "requires, contains",
    r"free[\s_]in[\s_]effect": "effective parameters",
    r"accurac(y|ies)[\s_]that[\s_]can[\s_]be[\s_]believed": "estimate, predicted RMSE",
}
REFUSED = [(re.compile(f"{_START}{word}{_END}", re.IGNORECASE), instead)
           for word, instead in WORDS.items()]
UNIT = re.compile(r"\[(nano-)?pixels?\b|(?<![\w.])\d[\d,.]*[ -]pixels?\b|\}\s?pixels?\b|"
                  r"\bin pixels\b|\bpixels? per\b", re.IGNORECASE)
# The option and field is code: the whole of a string, in backquotes, after a dot or before "=".
PROSE_POLISH = re.compile(r"""(?<![\w.`=/-])(?!(?<=["'])polish(ed)?["'])"""
                          r"polish(es|ed|ing)?(?![\w`=(])", re.IGNORECASE)
PARAMETER = re.compile(r"^[\w, ]+ : .*$", re.MULTILINE)  # as numpydoc declares them
# Public names that hold a left-out word: changing them would break callers.
NAMES = re.compile(r"\bwrong_lines\b")


def _label(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _text(path: Path) -> str:
    """Return the text of a page; the history of changes before 0.2.0 stays as it is."""
    text = path.read_text(encoding="utf-8")
    if path.name == "CHANGELOG.md" or _label(path) == "docs/reference/changelog.md":
        known = re.search(r"^## \[?0\.2\.0.*?(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
        return text[:known.end()] if known else text
    return text


def _prose(path: Path) -> str:
    """Return what of a file is prose: comments and strings of code, pages without their code."""
    text = _text(path)
    if path.suffix == ".md":
        return re.sub(r"^```.*?^```$|`[^`\n]+`", "``", text, flags=re.MULTILINE | re.DOTALL)
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", None)}
    return "\n".join(token.string for token in tokenize.generate_tokens(io.StringIO(text).readline)
                     if token.type in kinds)


def _left_out(text: str, prose: str) -> list[str]:
    """Return every left-out word with the words to use instead."""
    text = NAMES.sub("", text)
    found = [f"{match[0]!r}: write {instead}" for pattern, instead in REFUSED
             for match in pattern.finditer(text)]
    found += [f"{match[0]!r}: write px" for match in UNIT.finditer(text)]
    return found + [f"{match[0]!r}: write local refinement"
                    for match in PROSE_POLISH.finditer(PARAMETER.sub("", prose))]


@pytest.mark.parametrize("path", [*CODE, *PAGES], ids=_label)
def test_left_out_words_stay_out(path: Path) -> None:
    assert _left_out(_text(path), _prose(path)) == []


@pytest.mark.parametrize("text", [
    "a fault the user can " + "me" + "nd", "ME" + "NDABLE = 2", "lies be" + "side it",
    "drawn an" + "ew",
    "control is sha" + "red\nout among folds", "they be" + "ar on the model", "driven do" + "wn",
    "a doubt" + "ful point", "one wrong po" + "int", "it spe" + "aks of a file",
    "terms free in ef" + "fect", "RMSE [pix" + "el]", "0.5 pix" + "el", "12 pix" + "els",
    "f'{noise} pix" + "els'", "followed by a pol" + "ish."])
def test_a_left_out_word_is_refused(text: str) -> None:
    assert _left_out(text, text)


@pytest.mark.parametrize("text", [
    "recommended amendments of Mendes", "shared denominators, a share of the outliers",
    "the bearing of the rays, forbearing", "RMSE [px]", "the centre of a pixel", "empty pixels",
    "found.polish", "polish=False", "--set polish=false", "the option `polish`", '"polish": 3',
    "polish : Polish, optional", "found, polished : float", "nobody speaks", "Renewal"])
def test_other_words_are_accepted(text: str) -> None:
    assert _left_out(text, text) == []


def _words(node: ast.expr) -> str:
    """Return the text of a string expression, each embedded value as one word."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else "value"
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(part) if isinstance(part, ast.Constant) else "value"
                       for part in node.values)
    if isinstance(node, ast.BinOp):
        return _words(node.left) + _words(node.right)
    if isinstance(node, ast.IfExp):
        return max(_words(node.body), _words(node.orelse), key=len)
    return "value"


def _for_users(tree: ast.Module) -> Iterator[str]:
    """Yield messages, hints, docs of options and help texts of a module."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func).rpartition(".")[2]
        keywords = {keyword.arg: keyword.value for keyword in node.keywords}
        shown = [keywords[key] for key in ("hint", "help", "epilog", "what", "doc")
                 if key in keywords]
        if name in ("TermselError", "CornerError", "echo"):
            shown += node.args[:1]
        if name == "CornerError":
            shown += node.args[3:4]
        if name == "Option":
            shown += node.args[2:3]
        yield from map(_words, shown)


def _sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.:;?!])\s+|\n\s*\n|\n\s*[-|]", text)


@pytest.mark.parametrize("path", CODE, ids=_label)
def test_sentences_for_users_are_short(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    long = [sentence for text in _for_users(tree) for sentence in _sentences(text)
            if len(sentence.split()) > LONGEST]
    assert long == []


def test_sentences_are_found_and_counted() -> None:
    source = ('raise TermselError(f"one {two} three." + " four " + (five if six else "six"), '
              'hint="Seven. Eight nine")\nOption("name", 1, "Ten eleven.", help="Twelve")')
    texts = list(_for_users(ast.parse(source)))
    assert [len(sentence.split()) for text in texts for sentence in _sentences(text)] == \
        [1, 2, 3, 2, 1, 2]
