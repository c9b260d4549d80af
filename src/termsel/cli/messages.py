"""What termsel logs, on stderr."""

from __future__ import annotations

import logging


def show_messages() -> None:
    """Print what termsel logs, such as what an enumeration is about to do, on stderr."""
    logger = logging.getLogger("termsel")
    if not logger.handlers:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(message)s"))
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
