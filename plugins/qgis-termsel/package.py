"""Pack the plugin as a file that QGIS installs.

    python plugins/qgis-termsel/package.py [FILE.zip]
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

FOLDER = Path(__file__).with_name("qgis_termsel")


def main(target: Path) -> None:
    """Write the plugin's files, in their order, to a zip file."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(FOLDER.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                packed.write(file, str(file.relative_to(FOLDER.parent)))
    print(f"Written: {target}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "qgis_termsel.zip"))
