"""Environments of other packages, made where a benchmark needs them.

Each is a folder of build/environments, with the packages of a stated requirement. One that cannot
be installed is said so, by the reason that pip gives, and the benchmark goes on without.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import venv
from collections.abc import Sequence
from pathlib import Path

from benchmarks.sets import ROOT

ENVIRONMENTS = ROOT / "build" / "environments"


class NotInstalled(Exception):
    """An environment that cannot be made, with the reason."""


def python_of(name: str, requirements: Sequence[str], *, beside: bool = False) -> Path:
    """Return the Python of an environment, which is made at first.

    `beside` lets it import what this one has as well, after its own packages.
    """
    folder = ENVIRONMENTS / name
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    complete = folder / "requirements.txt"
    if complete.is_file() and complete.read_text(encoding="utf-8").split() == list(requirements):
        return python
    venv.create(folder, clear=True, with_pip=True)
    installed = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements],
        capture_output=True, text=True, check=False)
    if installed.returncode:
        raise NotInstalled(installed.stderr.strip().splitlines()[-1])
    if beside:
        packages = subprocess.run(
            [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
            capture_output=True, text=True, check=True).stdout.strip()
        these = sysconfig.get_path("purelib")
        # `addsitedir` follows editable installations, which a mere path would not.
        (Path(packages) / "beside.pth").write_text(f"import site; site.addsitedir({these!r})\n",
                                                   encoding="utf-8")
    complete.write_text("\n".join(requirements) + "\n", encoding="utf-8")
    return python
