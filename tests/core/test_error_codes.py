"""What a program can do about an error is decided by its code, not by the words of its message."""

from __future__ import annotations

from pathlib import Path

import pytest

import termsel

CASES = {
    "ground-alone": "id,x,y\nA,1,2\nB,3,4\nC,5,7\n",
    "image-alone": "id,line,sample\nA,1,2\nB,3,4\nC,5,7\n",
    "crs-unknown": "id,line,sample,x,y\nA,1,2,500000,10\nB,3,4,500100,50\nC,5,7,500300,20\n",
    "header-missing": "A,1.5,2.5,500000.5,10.5\nB,3.5,4.5,500100.5,50.5\nC,5.5,7.5,500300,20\n",
    "format-unknown": "some words\nin three lines\nof text\n"}


@pytest.mark.parametrize("code", CASES)
def test_an_error_has_a_code(code: str, tmp_path: Path) -> None:
    table = tmp_path / "points.csv"
    table.write_text(CASES[code], encoding="utf-8")
    with pytest.raises(termsel.TermselError) as raised:
        termsel.read(table)
    assert raised.value.code == code


def test_an_unknown_name_has_the_code_of_its_kind() -> None:
    with pytest.raises(termsel.TermselError) as raised:
        termsel.run("no-such-problem")
    assert raised.value.code == "problem-unknown"
    assert raised.value.name == "no-such-problem"
