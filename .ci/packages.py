"""Build the packages of the repository, each wheel from its own source package.

    python .ci/packages.py FOLDER

All are built by this process with its hatchling, as each starts in a tenth of what five processes
of `python -m build` take.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import tomllib
from pathlib import Path

from hatchling.build import build_sdist, build_wheel

ROOT = Path(__file__).parents[1]


def main(folder: Path) -> None:
    """Write source packages and wheels to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for package in (ROOT, *sorted(one.parent for one in ROOT.glob("plugins/*/pyproject.toml"))):
        system = tomllib.loads((package / "pyproject.toml").read_text("utf-8"))["build-system"]
        if system != {"requires": ["hatchling"], "build-backend": "hatchling.build"}:
            raise SystemExit(f"{package.name} is built by something else: {system}")
        os.chdir(package)
        source = build_sdist(str(folder))
        with tempfile.TemporaryDirectory() as unpacked:
            shutil.unpack_archive(folder / source, unpacked)
            os.chdir(Path(unpacked, source.removesuffix(".tar.gz")))
            print(source, build_wheel(str(folder)), flush=True)
            os.chdir(ROOT)  # Windows removes no folder that a process is in


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
