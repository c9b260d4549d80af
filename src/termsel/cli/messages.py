"""Log messages of termsel, on stderr."""

from __future__ import annotations

import logging


def show_messages() -> None:
    """Print the log messages of termsel, such as the plan of an enumeration, on stderr."""
    logger = logging.getLogger("termsel")
    if not logger.handlers:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(message)s"))
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
