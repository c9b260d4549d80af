"""What `python -m tests.lint` refuses and accepts; .ci/run holds the project against it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.lint.__main__ import main
from tests.lint.figures import MOST, SMALLEST, Figures
from tests.lint.words import left_out_words

# The rules read no tests, so the left-out words may stand here.
REFUSED = (
    "a fault the user can mend", "MENDABLE = 2", "a plain structure", "Places are pixels",
    "control is shared\nout among folds", "they bear on the model", "driven down",
    "a doubtful line", "one wrong point", "it speaks of a file", "terms free in effect",
    "plain\nstructures", "a point that\n    # judges", "the check RMSE",
    'f"{most} terms "\n    f"an axis"', "plane_polynomial", "a measurement of control",
    "RMSE [pixel]", "0.5 pixel", "12 pixels", "f'{noise} pixels'", "followed by a polish.")
ACCEPTED = (
    "recommended amendments of Mendes", "shared denominators, a share of the outliers",
    "the bearing of the rays, forbearing", "RMSE [px]", "the centre of a pixel", "empty pixels",
    "found.polish", "polish=False", "--set polish=false", "the option `polish`", '"polish": 3',
    "polish : Polish, optional", "found, polished : float", "nobody speaks", "Renewal")


@pytest.mark.parametrize(("texts", "lines"), [(REFUSED, {2}), (ACCEPTED, set())])
def test_left_out_words(texts: tuple[str, ...], lines: set[int]) -> None:
    for text in texts:
        # In prose around it, of a page and of a module.
        assert {line for line, _ in left_out_words(Path("a.md"), f"#\n{text}\n")} == lines, text
        module = f'"""A.\n{text}\n"""\n'
        assert {line for line, _ in left_out_words(Path("a.py"), module)} == lines, text


def test_code_is_no_prose() -> None:
    page = "One\n```\npolish the best\n```\nand `a polish b` and a polish\n"
    assert [line for line, _ in left_out_words(Path("a.md"), page)] == [5]
    module = "polish = [\n    polish for one in all]  # and a\n# polish of it\n"
    assert [line for line, _ in left_out_words(Path("a.py"), module)] == [3]


FILES = {
    "src/termsel/__init__.py": "import termsel.upper\n",
    "src/termsel/rooms.py": 'ROOMS = {"upper": "a", "lower": "b", "rooms": "c"}\n',
    "src/termsel/upper.py": "from termsel.lower import one\nimport termsel.lower.two\n",
    "src/termsel/lower/__init__.py": "",
    "src/termsel/lower/one.py": "ONE = 1\n",
    "src/termsel/lower/two.py": "import termsel.lower.one\n",
    "plugins/termsel-a/src/termsel_a/__init__.py": "A = 1\n",
    "plugins/termsel-a/tests/test_a.py": "def test_a(): ...\n",
    "CONTRIBUTING.md": "| room |\n|---|---|\n| `upper` | a |\n| `lower` | b |\n| `rooms` | c |\n",
}
"""A small project without a violation."""


@pytest.mark.parametrize(("changes", "violation"), [
    ({}, ""),
    ({"README.md": "A\nmend\n"}, "README.md:2: 'mend': write correct, fix"),
    ({"src/termsel/lower/one.py": "from functools import cache\n\n\n@cache\ndef one():\n"
      "    return 1\n"},
     "src/termsel/lower/one.py:4: a cache without a reason: say in a comment on this line why, or "
     "hold it by an object"),
    ({"src/termsel/lower/one.py": "from functools import cache\n\n\n@cache  # asked for often\n"
      "def one():\n    return 1\n"}, ""),
    ({"src/termsel/lower/one.py": "\ndef one():\n    import termsel.upper\n    return 1\n"},
     "src/termsel/lower/one.py:3: imports from a room above it: termsel.upper"),
    ({"src/termsel/lower/one.py": "ONE = 1\nimport termsel\n"},
     "src/termsel/lower/one.py:2: imports from a room above it: termsel"),
    ({"src/termsel/lower/one.py": "ONE = 1\nfrom . import two\n"},
     "src/termsel/lower/one.py:2: an import by dots"),
    ({"src/termsel/lower/one.py": "ONE = 1\nfrom termsel.lower import two\n"}, ": a circle: "),
    ({"src/termsel/cellar/__init__.py": ""},
     "src/termsel/rooms.py:1: the room 'cellar' is not listed"),
    ({"src/termsel/rooms.py": 'ROOMS = {"upper": "a", "lower": "b", "rooms": "c", "attic": "d"}\n'},
     "src/termsel/rooms.py:1: the room 'attic' is listed and does not exist"),
    ({"src/termsel/notes.txt": ""}, "src/termsel/notes.txt:1: no module stands here"),
    ({"plugins/termsel-a/src/termsel_a/__init__.py": "A = 1\nfrom termsel.lower import one\n"},
     "plugins/termsel-a/src/termsel_a/__init__.py:2: not public: termsel.lower one"),
    ({"plugins/termsel-a/src/termsel_a/__init__.py": "A = 1\nimport termsel.lower.one\n"},
     "plugins/termsel-a/src/termsel_a/__init__.py:2: not public: termsel.lower.one;"),
    ({"plugins/termsel-a/tests/test_a.py": "A = 1\nfrom termsel.lower import one\n"},
     "plugins/termsel-a/tests/test_a.py:2: not public: termsel.lower one"),
    ({"plugins/termsel-a/tests/test_a.py": "A = 1\nfrom termsel.testing.problems import toy, no\n",
      "src/termsel/testing/problems.py": "__all__ = ['toy']\n"},
     "plugins/termsel-a/tests/test_a.py:2: not public: termsel.testing.problems no"),
    ({"plugins/termsel-a/src/termsel_a/__init__.py": "A = 1\nfrom termsel.toolkit import one\n",
      "src/termsel/toolkit/__init__.pyi": "from termsel.lower.two import two as two\n"},
     "plugins/termsel-a/src/termsel_a/__init__.py:2: not public: termsel.toolkit one"),
    ({"plugins/termsel-a/src/termsel_a/__init__.py": "A = 1\nfrom termsel.toolkit import one\n",
      "src/termsel/toolkit/__init__.pyi": "from termsel.lower.one import one as one\n"}, ""),
    ({"CONTRIBUTING.md": "\n| room | what |\n"}, "CONTRIBUTING.md:2: the table of rooms"),
])
def test_each_violation_is_shown_with_its_place(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, str],
        violation: str) -> None:
    for name, text in (FILES | changes).items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert main(tmp_path) == int(bool(violation))
    assert (violation or "words and rooms are in order\n") in capsys.readouterr().out


def test_figures_of_plain_code(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text('''"""Text."""

SIZE = 3
# A reason.
def read(place, n, m):
    """Return it."""
    n, m = m, n  # no line of its own
    texts = [a for row in place for a in row]
    call(1, 2, 3, 4, 5, 6, 7)
    return "a" * (n > m)
''')
    figures = Figures()
    figures.count(module)
    assert (figures.code, figures.comments, figures.names) == (6, 1, 9)
    assert figures.counts == dict.fromkeys(MOST, 1)
    assert figures.modules_of_constant == {"SIZE": {module}}


def test_large_trees_are_judged_by_their_figures(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "src/termsel/lower/one.py").write_text("given = 1\n" * SMALLEST)
    assert main(tmp_path) == 1
    out = capsys.readouterr().out
    assert "src/termsel:1: vague names, by 100 names: " in out
    assert "src/termsel:1: 0.0 comments by 100 lines of code" in out
