"""The gallery of the documentation: its form, and that a page which is not true is refused.

The cases themselves are run when the documentation is built.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(page for page in (DOCS / "how-to" / "gallery").glob("*.md")
               if page.stem != "index")


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        return importlib.import_module("gallery")


def test_there_are_ten_cases() -> None:
    assert len(PAGES) == 10


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_statements_of_a_case_are_checked(page: Path) -> None:
    assert len(re.findall(r"^<!-- true: .+ -->$", page.read_text(encoding="utf-8"),
                          re.MULTILINE)) >= 2


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_case_has_picture_command_sight_and_remedy_in_this_order(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    order = [re.search(pattern, text, re.MULTILINE) for pattern in (
        r"\A# .+\n\n```{image} pictures/[\w-]+\.svg\n:alt: .{40,}\n```$",
        r"^\$ termsel (run|compare) ",
        r"^## What you see$", r"^## What you do then$")]
    assert all(order)
    places = [found.start() for found in order if found]
    assert places == sorted(places)


def test_every_page_has_its_picture_which_is_small() -> None:
    shown = {name for page in PAGES
             for name in re.findall(r"{image} (\S+)", page.read_text(encoding="utf-8"))}
    there = {f"pictures/{path.name}": path for path in (PAGES[0].parent / "pictures").iterdir()}
    assert shown == set(there)
    for path in there.values():
        assert ElementTree.parse(path).getroot().tag.endswith("svg")
        assert path.stat().st_size < 150_000


CASE = """# A case

```python
print("one", 2.5)
```

```text
one 1.0
```

```console
$ termsel plugins --json
...
]
```

"""


def test_output_shown_is_what_is_printed(gallery: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "case.md").write_text(CASE + "<!-- true: 2 > 1 -->\n")
    (tmp_path / "index.md").write_text("```console\n$ termsel nothing\n```\n")
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    (pictures / "stale.svg").write_text("<svg/>")
    assert list(gallery.made(tmp_path)) == ["case"]
    assert len(list(pictures.iterdir())) == 1  # a build leaves pictures as they are
    found = gallery.made(tmp_path, pictures)
    assert "one 2.5\n" in found["case"]
    assert not list(pictures.iterdir())


STUDY = """```console
$ termsel compare --problem poly-terms --solver random,swap --seeds 3 --evaluations 40 --out s
...
```

"""


@pytest.mark.parametrize(("said", "true"), [
    ("reached(s, 'random', 40) == column(s, 'random', 'fitness')", True),
    ("reached(s, 'swap', 40) > column(s, 'swap', 'fitness')", False),
    ("len(s.rows) == 6", True)])
def test_statements_on_a_study_are_checked(gallery: ModuleType, tmp_path: Path, said: str,
                                           true: bool) -> None:
    (tmp_path / "case.md").write_text(f"{STUDY}<!-- true: {said} -->\n")
    if true:
        gallery.made(tmp_path)
        return
    with pytest.raises(gallery.Untrue, match="not true"):
        gallery.made(tmp_path)


@pytest.mark.parametrize(("text", "says"), [
    (CASE.replace("one 1.0", "two 1.0"), "shows of"),
    (CASE + "<!-- true: 1 > 2 -->\n", "not true: 1 > 2"),
    (CASE + "```{image} pictures/none.svg\n```\n", "which it does not draw"),
    ("```console\n$ rm -r result\n```\n", "no command of termsel")])
def test_a_page_that_is_not_true_is_refused(gallery: ModuleType, tmp_path: Path, text: str,
                                            says: str) -> None:
    (tmp_path / "case.md").write_text(text)
    with pytest.raises(gallery.Untrue, match=says):
        gallery.made(tmp_path)
