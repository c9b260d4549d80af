"""The built reference names all that a third party may use."""

from __future__ import annotations

import inspect
import re
import shutil
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import termsel

ROOT = Path(__file__).parents[2]
MODULES = ("termsel", "termsel.simulate", "termsel.testing", "termsel_sklearn",
           "termsel_optimisers")
PROBLEMS = "termsel.testing.problems"
"""A module with problems for tests, whose classes are described as a whole."""
FOREIGN = ("sklearn", "builtins", "enum")


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names of all objects that the pages of the reference document, as Sphinx builds it."""
    application = pytest.importorskip("sphinx.application")
    from sphinx.util.docutils import docutils_namespace, patch_docutils

    source, built = tmp_path_factory.mktemp("docs"), tmp_path_factory.mktemp("built")
    for page, name in (("api", "index"), ("api-authors", "api-authors")):
        shutil.copy(ROOT / "docs" / "reference" / f"{page}.md", source / f"{name}.md")
    settings = {
        "extensions": ["myst_parser", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.autosummary"],
        "templates_path": [str(ROOT / "docs" / "_templates")], "autosummary_generate": True,
        "numpydoc_show_class_members": False, "myst_heading_anchors": 0}
    with patch_docutils(), docutils_namespace():
        app = application.Sphinx(source, None, built, built / "trees", "dummy",
                                 confoverrides=settings, status=None, warning=None)
        app.build()
        return set(app.env.get_domain("py").objects)


def _public(module: ModuleType) -> list[tuple[str, object]]:
    return [(name, getattr(module, name)) for name in module.__all__ if name != "__version__"]


def _in_docstring(cls: type, name: str) -> bool:
    """Return whether a section of a docstring describes an attribute."""
    return any(re.search(rf"^\s*(?:\w+, )*{name}(?:, \w+)*(?: :|$)", base.__doc__ or "",
                         re.MULTILINE) for base in cls.__mro__)


def _attributes(cls: type) -> list[str]:
    """Return the public attributes of a class that are termsel's."""
    found = []
    for base in cls.__mro__:
        if base.__module__.partition(".")[0] in FOREIGN or base.__module__ in ("abc", "typing"):
            continue
        names = {*vars(base), *vars(base).get("__annotations__", {})}
        # What scikit-learn puts into every estimator is called set_score_request and the like.
        found += [name for name in names
                  if not name.startswith("_") and not name.endswith("_request")]
    return sorted(set(found))


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_the_reference_has_every_public_name_and_attribute(name: str, objects: set[str]) -> None:
    missing = []
    for called, thing in _public(import_module(name)):
        if not {f"{one}.{called}" for one in MODULES} & objects:
            missing.append(called)
        elif inspect.isclass(thing):
            own = thing.__name__  # of another name for a class
            missing += [f"{called}.{attribute}" for attribute in _attributes(thing)
                        if f"{name}.{own}.{attribute}" not in objects
                        and not _in_docstring(thing, attribute)]
    assert missing == []


@pytest.mark.slow
def test_the_reference_has_nothing_else(objects: set[str]) -> None:
    public = {f"{name}.{called}" for name in MODULES
              for called, _ in _public(import_module(name))}
    top = {one for one in objects if one.rpartition(".")[0] in MODULES}
    assert top - public - {*MODULES, PROBLEMS} == set()
    assert {f"termsel.{name}" for name in termsel.__all__} - {"termsel.__version__"} <= top
