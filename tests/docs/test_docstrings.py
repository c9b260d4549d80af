"""Public functions say what they return, and show how they are used."""

from __future__ import annotations

import doctest
import inspect
import re
from importlib import import_module, util
from pathlib import Path
from typing import Any

import pytest

import termsel
from termsel.results.result import Result

FUNCTIONS = [name for name in termsel.__all__ if inspect.isfunction(getattr(termsel, name))]
CLASSES = [name for name in termsel.__all__ if inspect.isclass(getattr(termsel, name))]
OTHER_MODULES = ("termsel.simulate", "termsel.testing", "termsel_block", "termsel_cameras",
                 "termsel_formats", "termsel_hybrids", "termsel_optimisers", "termsel_rpc",
                 "termsel_sklearn", "termsel_standards", "termsel_studies")
"""Modules with public names besides `termsel`."""


def _public_functions() -> list[Any]:
    """Return the public functions of the other modules that are installed."""
    modules = [import_module(name) for name in OTHER_MODULES if util.find_spec(name)]
    things = [getattr(module, name) for module in modules for name in module.__all__]
    return [thing for thing in things if inspect.isfunction(thing)]


OTHER_FUNCTIONS = _public_functions()


def _sections(thing: object) -> set[str]:
    """Return the headings of a docstring, as numpydoc underlines them."""
    return set(re.findall(r"^([A-Z]\w+)\n-{3,}$", inspect.getdoc(thing) or "", re.MULTILINE))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_public_function_has_returns_and_an_example(name: str) -> None:
    sections = _sections(getattr(termsel, name))
    assert sections & {"Returns", "Yields"}
    assert "Examples" in sections


@pytest.mark.parametrize("function", OTHER_FUNCTIONS, ids=lambda function: function.__name__)
def test_a_public_function_of_other_modules_has_returns_and_an_example(function: Any) -> None:
    sections = _sections(function)
    returns_nothing = inspect.signature(function).return_annotation in (None, "None")
    assert returns_nothing or sections & {"Returns", "Yields"}
    assert "Examples" in sections


def _public_classes() -> list[type]:
    """Return the public classes of termsel and of the other modules that are installed."""
    modules = [termsel, *(import_module(name) for name in OTHER_MODULES if util.find_spec(name))]
    things = [getattr(module, name) for module in modules for name in module.__all__]
    return list(dict.fromkeys(thing for thing in things if inspect.isclass(thing)))


@pytest.mark.parametrize("documented", _public_classes(), ids=lambda cls: cls.__name__)
def test_public_methods_say_what_they_return(documented: type) -> None:
    """In the first words, as numpydoc has it for docstrings of one line, or in a section."""
    silent = []
    for name, member in vars(documented).items():
        method = getattr(member, "__func__", member)
        if name.startswith("_") or not inspect.isfunction(method) \
                or inspect.signature(method).return_annotation in (None, "None"):
            continue
        text = inspect.getdoc(method) or ""
        if not text.startswith(("Return ", "Yield ")) and not _sections(method) & {
                "Returns", "Yields"}:
            silent.append(name)
    assert not silent


@pytest.mark.parametrize("name", CLASSES)
def test_a_public_class_has_an_example(name: str) -> None:
    assert "Examples" in _sections(getattr(termsel, name))


def test_a_result_documents_attributes() -> None:
    assert {"Attributes", "Examples"} <= _sections(Result)
    assert "Parameters" not in _sections(Result)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "documented", [*[getattr(termsel, name) for name in [*FUNCTIONS, *CLASSES]], *OTHER_FUNCTIONS],
    ids=lambda documented: documented.__name__)
def test_examples_show_what_is_printed(documented: Any, tmp_path: Path,
                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example = doctest.DocTestParser().get_doctest(
        inspect.getdoc(documented) or "", {}, documented.__name__, None, None)
    assert example.examples
    lines: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=lines.append)
    assert "".join(lines) == ""
