"""Import numba without the settings that a file in the current folder has for it.

Numba reads ``.numba_config.yaml`` there. One that came with somebody's data could name a folder of
compiled code, which then runs. The variables NUMBA_... are the user's own, and hold.
"""

from __future__ import annotations

import sys
import warnings

NO_FILE = ""
"""Name of a file of settings that there never is."""


def import_numba() -> None:
    """Import numba so that it reads no file of settings.

    Where it is imported already, the settings that it read from a file are undone.
    """
    imported = "numba.core.config" in sys.modules
    before = sys.modules.get("yaml")
    if not imported:
        # Numba reads its file of settings only if it can import yaml.
        sys.modules["yaml"] = None  # type: ignore[assignment]
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "A Numba config file is found")
            from numba.core import config
    finally:
        if before is not None:
            sys.modules["yaml"] = before
        elif not imported:
            del sys.modules["yaml"]
    if config._config_fname != NO_FILE:
        config._config_fname = NO_FILE
        config.reload_config()  # changes nothing where no file was read
