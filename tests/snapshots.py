"""Texts that were looked at once: a test compares what is printed now with the file of each.

``TERMSEL_SNAPSHOTS=write pytest tests/report`` writes the files again; look at what git shows then.
"""

from __future__ import annotations

import os
from pathlib import Path


def require_same(path: Path, text: str) -> None:
    """Compare a text with its file, or write the file where that is asked for."""
    if os.environ.get("TERMSEL_SNAPSHOTS") == "write":
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")
