"""What the certificate of an RFM of second order takes.

``python -m benchmarks.certificates --out FILE`` proves, certifies and checks it (19 terms per
image coordinate). FILE gets the figures as JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import termsel
from termsel.check import check


def main() -> None:
    """Certify, check and write what it took."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.write_text(json.dumps(second(), indent=1))


def second() -> dict[str, Any]:
    """Return what the certificate of the RFM of second order takes."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "certificate.json"
        start = time.process_time()
        termsel.run("rfm-terms", solver="exact",
                    options={"order": 2, "certificate": True, "workers": 1}, out=folder)
        written = time.process_time()
        lines, open_ = check(file)
        return {"lines": lines, "open": open_, "bytes": file.stat().st_size,
                "write": written - start, "check": time.process_time() - written,
                "steps": [len(one["nodes"]) for one in json.loads(file.read_text())["axes"]]}


if __name__ == "__main__":
    main()
