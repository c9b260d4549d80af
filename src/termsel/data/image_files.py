"""What the file of an image is recognised by, lest a map is made of another sheet."""

from __future__ import annotations

import os
import zipfile
from hashlib import blake2b
from pathlib import Path

from termsel.data.record.record import ImageFile

WHOLE = 32_000_000
"""Bytes of a file up to which all of it is in the digest: a few hundredths of a second."""

AT_EACH_END = 8_000_000
"""Bytes of a larger file that are in the digest, at its beginning and at its end."""

_DIGEST_BYTES = 16


def image_file_of(path: Path | str) -> ImageFile | None:
    """Return what an image is recognised by; None where it is no file of this computer by itself.

    Folders and archives have none: the same image may be taken out of them.
    """
    if not os.path.isfile(path) or zipfile.is_zipfile(path):
        return None
    digest = blake2b(digest_size=_DIGEST_BYTES)
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size <= WHOLE:
                digest.update(file.read(WHOLE))
            else:
                digest.update(file.read(AT_EACH_END))
                file.seek(-AT_EACH_END, os.SEEK_END)
                digest.update(file.read(AT_EACH_END))
    except OSError:
        # Whoever needs the pixels says why it cannot be read.
        return None
    return ImageFile(Path(path).name, size, digest.hexdigest())
