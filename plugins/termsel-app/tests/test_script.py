"""The JavaScript of the page: typed, and tested without a browser, where Node.js is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
PAGE = HERE.parent / "src" / "termsel_app" / "page"
TYPESCRIPT = "typescript@5.9.3"


@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not installed")
def test_its_modules(tmp_path: Path) -> None:
    # Node takes them for modules only where a file beside them says so.
    copied = tmp_path / "page"
    shutil.copytree(PAGE, copied, ignore=shutil.ignore_patterns("vendor"))
    (copied / "package.json").write_text('{"type": "module"}')
    done = subprocess.run(
        [shutil.which("node") or "node", "--test", str(HERE / "page.test.mjs")], check=False,
        capture_output=True, text=True, timeout=60,
        env={**os.environ, "TERMSEL_PAGE": f"{copied.as_uri()}/"})
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not installed")
def test_its_types(tmp_path: Path) -> None:
    npm = shutil.which("npm") or "npm"
    fetched = subprocess.run([npm, "install", "--silent", "--no-audit", "--no-fund", TYPESCRIPT],
                             cwd=tmp_path, check=False, capture_output=True, timeout=300)
    if fetched.returncode:
        pytest.skip("TypeScript cannot be fetched")
    compiler = tmp_path / "node_modules" / "typescript" / "bin" / "tsc"
    done = subprocess.run([shutil.which("node") or "node", str(compiler), "--project",
                           str(HERE / "tsconfig.json")],
                          check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout
