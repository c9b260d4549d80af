"""Remote sources of rasters and vector files: refused unless they are allowed.

A file can name others, on servers too, and opening it would fetch them: a stranger's VRT could
make any request from this machine. What a file names is looked at before GDAL opens it; and while
GDAL works, all its requests go to a proxy that does not exist.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from xml.etree import ElementTree

from termsel.errors import TermselError, cut

HINT = "If you trust it, add --allow-remote (in Python: with termsel.allow_remote())."

NO_PROXY_EXISTS = "refused://allow-remote"
"""A proxy of no known kind: curl fails before it opens a connection."""

REFUSING = {"GDAL_HTTP_PROXY": NO_PROXY_EXISTS, "GDAL_HTTPS_PROXY": NO_PROXY_EXISTS,
            "GDAL_HTTP_MAX_RETRY": "0"}
"""Options of GDAL under which it makes no request."""

_EXCEPTIONS = ("no_proxy", "NO_PROXY")  # hosts for which curl takes no proxy
_REMOTE = re.compile(r"/vsi(curl|s3|gs|az|adls|oss|swift|hdfs|webhdfs)(_streaming)?[/?]"
                     r"|\b(https?|ftp)s?:/", re.IGNORECASE)
_FILES = re.compile(r"(DATASET|FILE|FILENAME|DEM|SOURCE|URL)$", re.IGNORECASE)
"""Keys of metadata that name files; others may mention any address."""

_allowed: ContextVar[bool] = ContextVar("allowed", default=False)


@contextmanager
def allow_remote() -> Iterator[None]:
    """Allow sources on servers while the block runs.

    Without it, no file that is read as raster or vector data makes GDAL send a request.
    """
    token = _allowed.set(True)
    try:
        yield
    finally:
        _allowed.reset(token)


def remote_allowed() -> bool:
    """Return True where sources on servers are allowed."""
    return _allowed.get()


@contextmanager
def local_alone(path: Path | str) -> Iterator[dict[str, str]]:
    """Refuse a file with remote sources, and yield options under which GDAL makes no request.

    They are empty where remote sources are allowed. Raises TermselError if the name is that of a
    remote source; if the file, its ``.aux.xml``, or a file of the same kinds that they name, names
    one.
    """
    if remote_allowed():
        yield {}
        return
    name = next(_remote_names(Path(path)), None)
    if name is not None:
        raise TermselError(f"this refers to the remote source {cut(name, 100)!r}, which is refused",
                           file=path, hint=HINT)
    # The same environment for all threads: taken out only where it is set at all.
    lifted = {key: os.environ.pop(key) for key in _EXCEPTIONS if key in os.environ}
    try:
        yield REFUSING
    finally:
        os.environ.update(lifted)


def _remote_names(path: Path) -> Iterator[str]:
    """Yield remote names: of the file itself, and in XML by which it may name others."""
    if _REMOTE.search(str(path)):
        yield str(path)
        return
    waiting, seen = [str(path)], set()
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        folder = os.path.dirname(file)
        for name in (*_names(file), *_names(f"{file}.aux.xml")):
            if _REMOTE.search(name):
                yield name.strip()
            # Relative to the file or to the current folder.
            waiting += filter(os.path.isfile, (os.path.join(folder, name.strip()), name.strip()))


def _names(file: str) -> Iterator[str]:
    """Yield every text of an XML file that can be the name of a file; nothing of other files."""
    if not os.path.isfile(file):  # a pipe, which is read once, has no XML for GDAL
        return
    try:
        with open(file, "rb") as opened:
            if not opened.read(64).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
                return
            opened.seek(0)
            content = opened.read()
    except OSError:  # GDAL says why
        return
    try:
        yield from _texts(ElementTree.fromstring(content))
    except (ElementTree.ParseError, LookupError, ValueError):  # GDAL may read it all the same
        yield from re.split(r"[<>\"']", content.decode("latin-1"))


def _texts(element: ElementTree.Element) -> Iterator[str]:
    waiting = [element]
    while waiting:
        one = waiting.pop()
        if one.tag == "Metadata":
            yield from (item.text or "" for item in one.iter("MDI")
                        if _FILES.search(item.get("key", "")))
            continue
        yield one.text or ""
        yield from (value for key, value in one.items() if "schemaLocation" not in key)
        waiting += one
