"""Sphinx settings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

import termsel

sys.path.insert(0, str(Path(__file__).parent))
# The reference has the public names of these packages whether or not they are installed.
sys.path.extend(str(Path(__file__).parents[1] / "plugins" / name / "src")
                for name in ("termsel-sklearn", "termsel-optimisers"))

project = "termsel"
author = "The termsel developers"
copyright = "the termsel developers"
version = release = termsel.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_click",
]

myst_enable_extensions = ["colon_fence", "dollarmath", "amsmath", "deflist", "attrs_block"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
templates_path = ["_templates"]
exclude_patterns = ["_build", "Thumbs.db", ".DS_Store"]
default_role = "py:obj"
smartquotes = False  # which would make --option of a command into an en dash

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types with shapes and units
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "furo"
html_title = f"termsel {release}"
html_static_path = ["_static"]
html_show_sphinx = False


def inline_math(writer: Any, node: nodes.math) -> None:
    """Write a formula as MathML, which browsers draw without a script from elsewhere."""
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def displayed_math(writer: Any, node: nodes.math_block) -> None:
    """Write a formula that stands alone."""
    writer.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def fill(app: Sphinx, name: str, source: list[str]) -> None:
    """Put what is generated from the code into a page that is read."""
    from generated import filled

    source[0] = filled(app.cases.get(name, source[0]))


def run_gallery(app: Sphinx) -> None:
    """Run the cases of the gallery, and keep their pages by name."""
    from gallery import made

    app.cases = {f"how-to/gallery/{name}": text for name, text in made().items()}


def outdated(app: Sphinx, *_args: Any) -> list[str]:
    """Return the pages to be read whether they changed or not: the cases are run anew."""
    return list(app.cases)


def examples(_app: Sphinx, _context: Any, lines: list[str]) -> None:
    """Set the examples of a command as code: click's paragraphs of lines that are kept."""
    text: list[str] = []
    kept = False
    for line in lines:
        if not line.startswith("|"):
            text.append(line)
        elif line.endswith(":"):
            text += [line[2:], ""]
        else:
            text += ([] if kept else [".. code-block:: sh", ""]) + [f"   {line[2:]}"]
        kept = line.startswith("|") and not line.endswith(":")
    lines[:] = text


def frame_pictures(_app: Sphinx, page: nodes.document) -> None:
    """Put each picture in a paragraph of its own, which scrolls alone on a narrow screen."""
    for picture in list(page.findall(nodes.image)):
        if isinstance(picture.parent, (nodes.section, nodes.document)):
            paragraph = nodes.paragraph()
            picture.replace_self(paragraph)
            paragraph += picture


def navigate(_app: Sphinx, _page: str, _template: str, context: dict[str, Any],
             _doctree: nodes.document | None) -> None:
    """Expand the branch of a page alone: the tree of all 280 on each takes half of a build."""
    tree = context["toctree"]
    context["toctree"] = lambda **asked: tree(**{**asked, "collapse": True})


def setup(app: Sphinx) -> None:
    """Register how formulae are written and pages are filled."""
    app.connect("builder-inited", run_gallery)
    app.connect("env-get-outdated", outdated)
    app.connect("source-read", fill)
    app.connect("sphinx-click-process-description", examples)
    app.connect("doctree-read", frame_pictures)
    app.connect("html-page-context", navigate, priority=400)  # before the theme asks for it
    app.add_html_math_renderer("mathml", (inline_math, None), (displayed_math, None))
    app.add_css_file("termsel.css")
