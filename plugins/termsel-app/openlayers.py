"""OpenLayers for the page: fetched by npm when a package is built, and never committed.

A source package brings it along, so that who builds from one needs no npm. Where npm is missing the
package is built without it, and `termsel app` says what to do.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "ol@10.11.0"
SHA512 = "OJ+lrx7kx/1O7Xx18Ff9QkVnwZIEL0OuhJQSy2sYgzzDvyZ2qHvuZEGAajbSstUyBwaS1OtQ4RWnY84tRMDdqg=="
"""Checksum of the package, as the registry of npm states it."""
FILES = {"ol.js": "package/dist/ol.js", "ol.css": "package/ol.css",
         "LICENSE.md": "package/LICENSE.md"}
"""What is taken, and where it is in the package."""
PLACE = "termsel_app/page/vendor"


class OpenLayersHook(BuildHookInterface[Any]):
    """Adds OpenLayers to source packages and wheels."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Fetch the files of OpenLayers if any is missing, and add them to the package to be built.

        Without npm or network it only warns: the package then has no page.
        """
        folder = Path(self.root, "vendor")
        if not all((folder / name).is_file() for name in FILES):
            try:
                fetch(folder)
            except (OSError, subprocess.SubprocessError, ValueError) as error:
                self.app.display_warning(
                    f"OpenLayers could not be fetched by npm ({error}): this package of "
                    "termsel-app has no page. Install Node.js and build it again.")
                return
        target = PLACE if self.target_name == "wheel" else "vendor"
        for name in FILES:
            build_data["force_include"][str(folder / name)] = f"{target}/{name}"


def fetch(folder: Path) -> None:
    """Fetch the package of OpenLayers by npm, and write the files of `FILES` to a folder.

    Raises OSError without npm, ValueError if the package has another checksum or lacks a file, and
    subprocess.SubprocessError if npm fails.
    """
    npm = shutil.which("npm")
    if npm is None:
        raise OSError("npm is not installed")
    with tempfile.TemporaryDirectory() as folder_of_archive:
        subprocess.run([npm, "pack", "--silent", PACKAGE], cwd=folder_of_archive, check=True,
                       timeout=300, stdout=subprocess.DEVNULL)
        archive = next(Path(folder_of_archive).glob("*.tgz"))
        # npm fetches what the registry has now; the checksum is that of the package reviewed.
        digest = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
        if digest != SHA512:
            raise ValueError(f"{PACKAGE} has another checksum")
        with tarfile.open(archive) as members:
            for name, member in FILES.items():
                content = members.extractfile(member)
                if content is None:
                    raise ValueError(f"{PACKAGE} has no {member}")
                write(folder / name, content.read())


def write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, as another build may be writing the same one."""
    path.parent.mkdir(exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}")
    unfinished.write_bytes(content)
    unfinished.replace(path)
