"""What every reader of ground control features must do."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.formats.base import Reader
from termsel.testing.cases import (
    Case,
    Suite,
    declaration_check,
    label_with_options,
    make_instance,
    require,
    require_refused,
)

HEAD = 65536
"""Bytes of a file that are shown to `sniff`."""

PIECES = 40
"""Places at which the example is cut off."""


@dataclass(frozen=True, eq=False)
class Example:
    """A reader, the content of a file it reads, and the features in that."""

    reader: Reader
    content: bytes
    expected: FeatureSet
    filename: str

    @property
    def text(self) -> str | None:
        """The content as text without a byte order mark, None where it is binary."""
        if b"\0" in self.content:
            return None
        try:
            return self.content.decode("utf-8-sig")
        except UnicodeDecodeError:
            return None


def reads_example(example: Example) -> None:
    """It reads the example correctly, each time, and does not change the file."""
    with TemporaryDirectory() as folder:
        path = _write_example(example, folder, example.content)
        # Twice, as a reader may keep something of the first time.
        for _ in range(2):
            _require_same(example.reader.read(path), example.expected, "the example")
        require(path.read_bytes() == example.content, "it changes the file it reads")
        require(list(Path(folder).iterdir()) == [path], "it creates files next to the one read")


def sniffs_example(example: Example) -> None:
    """It recognises the example by its content, without reading all of it."""
    with TemporaryDirectory() as folder:
        path = _write_example(example, folder, example.content)
        require(example.reader.sniff(path, example.content[:HEAD]) is True,
                "sniff() must be True for the example")


def sniffs_anything(example: Example) -> None:
    """It returns False for bytes without meaning, and never raises."""
    with TemporaryDirectory() as folder:
        for content, description in _noise_content():
            path = _write_example(example, folder, content)
            try:
                answer = example.reader.sniff(path, content[:HEAD])
            except Exception as error:
                raise AssertionError(
                    f"sniff() of {description} raises {type(error).__name__}: {error}; it must "
                    "return False for unknown content") from error
            require(answer is False, f"sniff() of {description} must be False, not {answer!r}")
        for size in _cut_lengths(example):
            content = example.content[:size]
            answer = example.reader.sniff(_write_example(example, folder, content), content)
            require(isinstance(answer, bool), f"sniff() must be True or False, not {answer!r}")


def truncated(example: Example) -> None:
    """A truncated file is read as far as it makes sense, or refused by its name."""
    with TemporaryDirectory() as folder:
        for size in _cut_lengths(example):
            _read_or_refuse(example, folder, example.content[:size],
                            f"the example cut off after {size} bytes")


def empty_file(example: Example) -> None:
    """An empty file is refused by its name."""
    for content, description in ((b"", "an empty file"), (b"\n \n", "a blank file")):
        _require_refused(example, content, description)


def binary_file(example: Example) -> None:
    """Bytes without meaning are refused by the name of the file."""
    for content, description in _noise_content():
        _require_refused(example, content, description)


def missing_file(example: Example) -> None:
    """A file that does not exist, and a folder, are refused by name."""
    with TemporaryDirectory() as folder:
        _require_file_refused(
            example, Path(folder) / "missing" / example.filename, "a file that does not exist")
        _require_file_refused(example, Path(folder), "a folder")


def wrong_encoding(example: Example) -> None:
    """Text that is not UTF-8 is refused by the name of the file, or read correctly."""
    if example.text is None:
        return
    with TemporaryDirectory() as folder:
        # UTF-16 holds the same text: it may be read, but not to other numbers.
        features = _read_or_refuse(example, folder, example.text.encode("utf-16"), "UTF-16 text")
        if features is not None:
            _require_same(features, example.expected, "the example as UTF-16")
        _read_or_refuse(example, folder, example.content + b"\xe9\xff", "text that is not UTF-8")


def line_ends(example: Example) -> None:
    """Text is read the same with line ends of Unix or Windows, without a last, and with a BOM.

    Nothing is required of a reader of binary files.
    """
    if example.text is None:
        return
    lines = example.text.replace("\r\n", "\n")
    with TemporaryDirectory() as folder:
        for text, description in ((lines, "line ends of Unix"),
                                  (lines.replace("\n", "\r\n"), "line ends of Windows"),
                                  ("\ufeff" + lines, "a byte order mark"),
                                  (lines.rstrip("\n"), "no line end in the last line")):
            path = _write_example(example, folder, text.encode())
            try:
                features = example.reader.read(path)
            except TermselError as error:
                raise AssertionError(
                    f"the example with {description} is refused: {error}") from error
            _require_same(features, example.expected, f"the example with {description}")


def cases(reader: type[Reader] | Reader, *, content: bytes, expected: FeatureSet,
          filename: str = "example.txt") -> list[Case]:
    """Return a reader with an example of its files."""
    example = Example(make_instance(reader), content, expected, filename)
    return [Case(label_with_options(reader, {}), lambda: example)]


SUITE = Suite((
    declaration_check("readers", lambda example: example.reader), reads_example, sniffs_example,
    sniffs_anything, truncated, empty_file, binary_file, missing_file, wrong_encoding, line_ends),
    cases)


def _write_example(example: Example, folder: str, content: bytes) -> Path:
    """Write content into a folder under the name of an example; return its path."""
    path = Path(folder) / example.filename
    path.write_bytes(content)
    return path


def _noise_content() -> list[tuple[bytes, str]]:
    """Return bytes without any meaning, the same in every run, with their description."""
    # The same bytes in every run.
    rng = np.random.default_rng(1)
    return [(rng.bytes(n), f"{n} random bytes") for n in (1, 16, 1000, 20000)] + [
        (bytes(100), "zero bytes")]


def _cut_lengths(example: Example) -> list[int]:
    """Return the lengths [bytes] to which an example is cut."""
    # Cuts all over the file, as each part of it is read by other code.
    return sorted({int(n) for n in np.linspace(0, len(example.content) - 1, PIECES)})


def _require_file_refused(example: Example, path: Path, description: str) -> None:
    """Raise AssertionError unless the reader refuses a file by its name."""
    require_refused(lambda: example.reader.read(path), path, description,
                    "is read as if nothing were wrong")


def _require_refused(example: Example, content: bytes, description: str) -> None:
    """Raise AssertionError unless the reader refuses this content."""
    with TemporaryDirectory() as folder:
        _require_file_refused(example, _write_example(example, folder, content), description)


def _read_or_refuse(example: Example, folder: str, content: bytes, description: str,
                    ) -> FeatureSet | None:
    """Return the features read from other content, or None if a TermselError names the file.

    Raises AssertionError for any other exception.
    """
    path = _write_example(example, folder, content)
    # If it raises, the reader is called again by a function that judges the exception.
    with suppress(Exception):
        return example.reader.read(path)
    _require_file_refused(example, path, description)
    return None


def _require_same(features: FeatureSet, expected: FeatureSet, description: str) -> None:
    """Refuse features that differ from the expected ones, and say in what."""
    pairs = (
        ("ids of points", features.points.ids, expected.points.ids),
        ("ids of lines", features.lines.ids, expected.lines.ids),
        ("roles", features.points.roles, expected.points.roles),
        ("crs", features.crs, expected.crs),
        ("image_size", features.image_size, expected.image_size),
        ("image coordinates of points", features.points.image, expected.points.image),
        ("ground coordinates of points", features.points.ground, expected.points.ground),
        ("standard deviations", features.points.sigma, expected.points.sigma),
        ("image coordinates of lines", features.lines.image, expected.lines.image),
        ("ground coordinates of lines", features.lines.ground, expected.lines.ground),
        ("standard deviations of lines", features.lines.sigma, expected.lines.sigma))
    for name, value, expected_value in pairs:
        if isinstance(value, np.ndarray) and isinstance(expected_value, np.ndarray):
            # Equal but for the rounding of other ways to read decimals; unknown heights are NaN.
            is_same = value.shape == expected_value.shape and np.allclose(
                value, expected_value, rtol=1e-12, atol=1e-9, equal_nan=True)
        else:
            is_same = value is expected_value or (
                type(value) is type(expected_value) and value == expected_value)
        require(is_same,
                f"{description} is read with the {name} {value}, expected {expected_value}")
