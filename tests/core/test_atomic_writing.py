"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from termsel.core.errors import TermselError
from termsel.core.files.atomic import atomic_path, write_bytes, write_text
from tests.csv_texts import put


def test_atomic_writing_replaces_whole_files(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    write_text(path, "né\r\n")
    assert path.read_bytes() == "né\r\n".encode()
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_keeps_the_old_file_on_failure(tmp_path: Path) -> None:
    path = put(tmp_path, "old", "out.tif")

    def fail() -> None:
        with atomic_path(path) as temporary:
            assert temporary.parent.parent == path.parent
            assert temporary.parent.stat().st_mode & 0o777 == 0o700 or os.name == "nt"
            assert temporary.name == path.name
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_writing_through_a_link(tmp_path: Path) -> None:
    path = put(tmp_path, "old", "real.txt")
    link = tmp_path / "link.txt"
    link.symlink_to(path)
    write_text(link, "new")
    assert link.is_symlink()
    assert path.read_text() == "new"


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    file = put(tmp_path, "a file")
    for path in (tmp_path, tmp_path / "none" / "out.txt", file / "out.txt", Path(os.devnull)):
        with pytest.raises(TermselError) as caught:
            write_text(path, "text")
        assert str(path) in str(caught.value)
    assert list(tmp_path.iterdir()) == [file]
