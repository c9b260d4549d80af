"""Run the commands and Python snippets of a page, and compare or renew what it shows.

    python docs/snippets.py README.md docs/tutorial/index.md      renews the output shown

``console`` blocks hold commands behind ``$ `` and their output, ``sh`` blocks commands alone;
``python`` blocks are run as files, and a ``text`` block that follows at once is what they print.
All run one after another in one folder, which ``cd`` changes. In the output shown, a line ``...``
stands for any number of lines. Blocks after the comment ``<!-- not run: why -->`` are left alone,
and so are the command for the tests and programs of others that are not installed. What installs
something, up to the last ``pip install ... &&``, is taken as done, and so is the download of the
files that the page offers.

The comparison leaves numbers out: another processor may round otherwise, and a search then finds
another selection.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ANYTHING = "..."
_FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_OUTPUT = re.compile(r"\n\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FAILURE = re.compile(r"Error: |images failed\.")
_NOT_RUN = re.compile(r"<!-- (not run|tests|generated: package)[^>]*-->\s*$")
_INSTALLS = re.compile(r".*\bpip install [^&|;]*(&& |$)")
_DOWNLOAD = re.compile(r"\{download\}`[^`<]*<([^`>]+)>`")
_CHANGES = re.compile(r"(?:(.*?) && )?cd (\S+)")
_ALONE = re.compile(r"termsel [^|;&$<>`*]*")
PROGRAMS = "termsel", "python", "head", "ls", "cat", "sort", "sed", "for"
OTHERS = "gdalwarp",
"""Programs that a page may use, and those that need not be installed."""
COMPILING = re.compile(r"^Compiling: .*\n", re.MULTILINE)
_CHECKSUM = re.compile(r"\b[0-9a-f]{64}\b")
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


@dataclass(frozen=True)
class Step:
    """One command or snippet, and the place of the output shown below it.

    Parameters
    ----------
    code : str
        A shell command, or Python.
    python : bool
    shown : str or None
        The output on the page; None where it is not shown.
    start, end : int
        Where the output is in the text of the page.
    """

    code: str
    python: bool
    shown: str | None
    start: int
    end: int


def steps(text: str) -> list[Step]:
    """Return what a page has the reader run, in order."""
    found = []
    for block in _FENCE.finditer(text):
        kind, body, start = block[1], block[2], block.start(2)
        if _NOT_RUN.search(text[:block.start()]):
            continue
        if kind == "python":
            output = _OUTPUT.match(text, block.end())
            found.append(Step(body, True, output[1], output.start(1), output.end(1)) if output
                         else Step(body, True, None, block.end(2), block.end(2)))
        if kind == "console":
            for command in re.finditer(r"^\$ ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", body,
                                       re.MULTILINE):
                found.append(Step(command[1], False, command[2], start + command.start(2),
                                  start + command.end(2)))
        if kind == "sh":
            found += [Step(re.sub(r"\s+#.*", "", command), False, None, block.end(2), block.end(2))
                      for command in re.findall(r"^(?:.*\\\n)*.*$", body, re.MULTILINE)
                      if command.strip()]
    return found


def download(page: Path, folder: Path) -> None:
    """Put the files that a page offers for download into a folder."""
    for name in _DOWNLOAD.findall(page.read_text(encoding="utf-8")):
        shutil.copy(page.parent / name, folder)


@dataclass
class Session:
    """A reader who follows a page.

    Parameters
    ----------
    folder : Path
        Where the next command runs.
    here : bool
        Run termsel and Python in this process, which saves a second each.
    """

    folder: Path
    here: bool = False

    def run(self, step: Step) -> str:
        """Return what a step prints on stdout and stderr, but for the note of a first run.

        Raises
        ------
        RuntimeError
            If it fails, and the page does not show an error.
        """
        code = step.code if step.python else _INSTALLS.sub("", step.code.replace("\\\n", " "))
        change = None if step.python else _CHANGES.fullmatch(code)
        if change:
            code = change[1] or ""
        printed, status = self._done(code, step.python) if code.strip() else ("", 0)
        if status and not _FAILURE.search(step.shown or ""):
            raise RuntimeError(f"{step.code}\nends with {status}:\n{printed}")
        if change:
            self.folder = self.folder / change[2]
        return COMPILING.sub("", printed)

    def _done(self, code: str, is_python: bool) -> tuple[str, int]:
        program = "python" if is_python else code.split()[0]
        if program not in (*PROGRAMS, *OTHERS):
            raise RuntimeError(f"{code}\nis not run by a test: say why in front of the block, "
                               "<!-- not run: why -->")
        if program in OTHERS and not shutil.which(program):
            return "", 0
        if self.here and is_python:
            return printed_by(lambda: exec(compile(code, "<snippet>", "exec"),
                                           {"__name__": "__main__"}), self.folder)
        if self.here and _ALONE.fullmatch(code):
            from termsel.cli.main import cli

            words = shlex.split(code)[1:]
            return printed_by(lambda: cli.main(words, prog_name="termsel"), self.folder)
        command = [sys.executable, "-c", code] if is_python else ["bash", "-c", code]
        done = subprocess.run(
            command, cwd=self.folder, env=_environment(self.folder), stdin=subprocess.DEVNULL,
            text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=300, check=False)
        return done.stdout, done.returncode


def printed_by(action: Callable[[], object], folder: Path) -> tuple[str, int]:
    """Return what an action in this process prints from a folder, and its exit code."""
    text, status = io.StringIO(), 0
    with (contextlib.chdir(folder), contextlib.redirect_stdout(text),
          contextlib.redirect_stderr(text)):
        try:
            action()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        except Exception:  # noqa: BLE001 - as Python does with one that nothing catches
            traceback.print_exc()
            status = 1
    return text.getvalue(), status


def _environment(folder: Path) -> dict[str, str]:
    """Return an environment in which `termsel` and `python` are this interpreter's."""
    programs = folder / ".programs"
    programs.mkdir(exist_ok=True)
    for name, module in (("termsel", "-m termsel"), ("python", "")):
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" {module} "$@"\n')
        program.chmod(0o755)
    return {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "COLUMNS": "80", "LC_ALL": "C.UTF-8"}


def skeleton(line: str) -> str:
    """Return a line without its numbers and without regard to the width of columns."""
    return " ".join(_NUMBER.sub("#", _CHECKSUM.sub("#", line)).split())


def first_word(line: str) -> str:
    """Return the first word of a line."""
    return skeleton(line).partition(" ")[0]


def renewed(shown: str, actual: str, alike: Callable[[str], str] = skeleton) -> str | None:
    """Return the shown output with what was actually printed in its place.

    Parameters
    ----------
    shown, actual : str
    alike : callable
        Two lines for which it returns the same are taken for each other.

    Returns
    -------
    str or None
        None if the two differ by more than that.
    """
    lines = _renewed(shown.splitlines(), actual.splitlines(), alike)
    return None if lines is None else "".join(f"{line}\n" for line in lines)


def _renewed(shown: list[str], actual: list[str], alike: Callable[[str], str],
             ) -> list[str] | None:
    if not shown:
        return None if actual else []
    if shown[0] == ANYTHING:
        for skipped in range(len(actual) + 1):
            rest = _renewed(shown[1:], actual[skipped:], alike)
            if rest is not None:
                return [ANYTHING, *rest]
        return None
    if not actual or alike(shown[0]) != alike(actual[0]):
        return None
    rest = _renewed(shown[1:], actual[1:], alike)
    return None if rest is None else [actual[0], *rest]


def main(pages: list[str]) -> None:
    """Renew the output shown on pages."""
    for page in pages:
        path = Path(page)
        text = path.read_text(encoding="utf-8")
        new, done = "", 0
        with tempfile.TemporaryDirectory() as folder:
            download(path, Path(folder))
            session = Session(Path(folder))
            for step in steps(text):
                actual = session.run(step)
                if step.shown is None:
                    continue
                lines = actual
                if ANYTHING in step.shown.splitlines():
                    kept = renewed(step.shown, actual) or renewed(step.shown, actual, first_word)
                    if kept is None:
                        sys.exit(f"{page}: correct it by hand, as nothing says what ... stands for"
                                 f"\n$ {step.code}\n{actual}")
                    lines = kept
                new += text[done:step.start] + lines
                done = step.end
        path.write_text(new + text[done:], encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
