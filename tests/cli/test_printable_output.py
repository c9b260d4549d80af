"""What reaches a terminal is printable: ids, headers, names of files and messages of libraries."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.cli import bars, messages, tables
from termsel.core.errors import TermselError, cut, make_printable

CLI = Path(messages.__file__).parent
ESC = "\x1b]0;pwned\x07\x1b[31m"


def test_printable_text_stays_and_the_rest_is_written_as_python_writes_it() -> None:
    for text in ("", "plain\n\ttext", "日本 café می\u200cخواهم", "a\u00a0b \ue000"):
        assert make_printable(text) == text
    assert make_printable("\x1b[31m\r\u202e\x9b\ud800\u2028\0") == (
        r"\x1b[31m\r\u202e\x9b\ud800\u2028\x00")


def test_commands_print_through_one_function() -> None:
    for path in CLI.glob("*.py"):
        calls = {ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text()))
                 if isinstance(node, ast.Call)}
        # The script of a shell is text of click's and has no names of files.
        raw = set() if path.stem in ("messages", "completion") else {
            "click.echo", "click.secho", "print"}
        assert not calls & raw, path.name


HEADER = f"id,line,{ESC}samp,x,y,z\nA,1,2,3,4,5\n"
IMAGES = json.dumps({"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"id": i, "filename": f"{ESC}{i}", "ji": [i, 3]},
     "geometry": {"type": "Point", "coordinates": [i, 4]}} for i in range(3)]})
HUGE = "id,line,sample,x,y,z\nA," + "1" * 50_000 + "x" * 50_000 + ",2,3,4,5\n"


@pytest.mark.parametrize(("content", "message"), [
    (HEADER, "no column for sample"), (IMAGES, "points of the images"),
    (HUGE, "is not a number. Write a plain number such as 12.5."),
    ("id,line,sample,x,y,z" + ",c" * 50_000 + "\nA,1\n", "the first row has 50,006 cells"),
    (("id,line,sample,x,z," + "c" * 100_000) + "\nA,1\n", "no column for y"),
], ids=["header", "images", "cell", "columns", "column"])
def test_bad_files(content: str, message: str, tmp_path: Path, call) -> None:
    path = tmp_path / f"{ESC}\npoints"
    path.write_text(content)
    done = call("run", "--problem", "poly-terms", "--points", path)
    assert done.exit_code == 2
    assert message in done.stderr
    assert make_printable(done.stderr) == done.stderr
    assert done.stderr.count("\n") == 1
    assert len(done.stderr) < 7000


@pytest.mark.parametrize("words", [
    ("run", "--problem", f"{ESC}x"), (f"{ESC}x",), ("run", f"--{ESC}x"), ("list", f"{ESC}x"),
    ("describe", f"{ESC}x"), ("run", "--problem", "poly-terms", "--set", f"{ESC}x=1"),
    ("export", f"{ESC}x", "--to", f"{ESC}x", "-o", "x")])
def test_bad_words(words: tuple[str, ...], call) -> None:
    done = call(*words)
    assert done.exit_code == 2
    assert make_printable(done.stderr) == done.stderr


def test_names_of_files_in_the_summary_and_its_file(tmp_path: Path, call) -> None:
    path = tmp_path / f"{ESC}.csv"
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1000, (30, 2))
    termsel.write_points_csv(termsel.Points(
        [f"P{i}" for i in range(30)], image, np.column_stack([image[:, ::-1], image[:, 0]])), path,
        "local")
    done = call("run", "--problem", "poly-terms", "--points", path, "--set", "degree=1", "--out",
                tmp_path / f"r{ESC}", "--evaluations", "20")
    assert done.exit_code == 0
    for text in (done.stdout, done.stderr, (tmp_path / f"r{ESC}" / "summary.txt").read_text()):
        assert make_printable(text) == text
    assert r"\x1b[31m.csv" in done.stdout


def test_tables_and_json(capsys, monkeypatch) -> None:
    tables.print_json({"a": f"{ESC}\x9b\U000e0001", "b": "é"})
    text = capsys.readouterr().out
    assert make_printable(text) == text
    assert json.loads(text) == {"a": f"{ESC}\x9b\U000e0001", "b": "é"}
    tables.print_json("é")
    assert capsys.readouterr().out == '"é"\n'
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    tables.print_table(("a",), [(ESC,)])
    assert "\x07" not in capsys.readouterr().out


def test_a_bar_shows_brackets_and_no_escape_sequence(capsys, monkeypatch) -> None:
    monkeypatch.setattr(bars.sys.stderr, "isatty", lambda: True)
    with bars.search_bar(f"[/nope] {ESC}", quiet=False) as observe:
        assert observe is not None
    drawn = capsys.readouterr().err
    assert "[/nope]" in drawn
    assert "\x1b]0" not in drawn


def test_long_parts_of_a_message_lose_their_middle() -> None:
    assert cut("a" * 10, 10) == "a" * 10
    assert cut("abcdefghij" * 10, 30) == "abcdefghijabcde ... abcdefghij"
    error = TermselError(f"{'x' * 10 ** 5!r} is not a number", hint="y" * 10 ** 5, file="f",
                         column="z" * 10 ** 5)
    assert "is not a number. y" in str(error)
    assert len(str(error)) < 6300


@pytest.mark.parametrize(("what", "shown"), [
    ("a fault", "a fault. Correct it."), ("no such CRS.", "no such CRS. Corr"),
    ("unknown for P0, P1 ...", "unknown for P0, P1 ... Correct it.")])
def test_a_sentence_has_one_full_stop(what: str, shown: str) -> None:
    assert str(TermselError(what, hint="Correct it.")).startswith(shown)
