"""Public functions say what they return, and show how they are used."""

from __future__ import annotations

import doctest
import inspect
import re
from pathlib import Path

import pytest

import termsel
from termsel.results.result import Result

FUNCTIONS = [name for name in termsel.__all__ if inspect.isfunction(getattr(termsel, name))]
CLASSES = [name for name in termsel.__all__ if inspect.isclass(getattr(termsel, name))]


def _sections(thing: object) -> set[str]:
    """Return the headings of a docstring, as numpydoc underlines them."""
    return set(re.findall(r"^([A-Z]\w+)\n-{3,}$", inspect.getdoc(thing) or "", re.MULTILINE))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_public_function_has_returns_and_an_example(name: str) -> None:
    sections = _sections(getattr(termsel, name))
    assert sections & {"Returns", "Yields"}
    assert "Examples" in sections


@pytest.mark.parametrize("name", CLASSES)
def test_a_public_class_has_an_example(name: str) -> None:
    assert "Examples" in _sections(getattr(termsel, name))


def test_a_result_documents_attributes() -> None:
    assert {"Attributes", "Examples"} <= _sections(Result)
    assert "Parameters" not in _sections(Result)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_examples_show_what_is_printed(name: str, tmp_path: Path,
                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(getattr(termsel, name)) or "", {}, name, None, None)
    assert example.examples
    lines: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=lines.append)
    assert "".join(lines) == ""
