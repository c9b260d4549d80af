"""How far certificates reach: RFM of second order in full, pieces of the RFM of 78 terms.

``python -m benchmarks.certificates --out FILE`` proves, certifies and checks the RFM of second
order (19 terms an axis), then certifies and checks pieces of the optimum of gap-to-optimum.md. A
piece is drawn by a random way down the tree, so that the size of the whole tree can be estimated
(Knuth 1975, Mathematics of Computation 29: 121-136). FILE gets the figures as JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import termsel
from benchmarks.gap import OPTIMUM
from termsel.check import check, checksum
from termsel.solvers.proofs.proof import limits_of
from termsel_bench.certificate import axis_of, tree_of

DEPTH = 22
"""Terms that a piece has decided; the other 17 are open."""


def main() -> None:
    """Certify, check and write what it took."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pieces", type=int, default=40, help="pieces of each axis")
    asked = parser.parse_args()
    figures: dict[str, Any] = {"pieces": [one for axis in axes() for one in pieces(
        axis, asked.pieces)]}
    asked.out.write_text(json.dumps(figures, indent=1))
    figures["second"] = second()
    asked.out.write_text(json.dumps(figures, indent=1))


def second() -> dict[str, Any]:
    """Return what the certificate of the RFM of second order takes."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "proof.json"
        start = time.process_time()
        termsel.run("rfm-terms", solver="exact",
                    options={"order": 2, "certificate": str(file), "workers": 1})
        written = time.process_time()
        lines, open_ = check(file)
        return {"lines": lines, "open": open_, "bytes": file.stat().st_size,
                "write": written - start, "check": time.process_time() - written,
                "steps": [len(one["nodes"]) for one in json.loads(file.read_text())["axes"]]}


def axes() -> list[dict[str, Any]]:
    """Return the axes of the RFM of 78 terms, with the proven optimum and without trees."""
    problem = termsel.prepare("rfm-terms", solver="exact").problem
    chosen = OPTIMUM.split()
    names = problem.decode(np.ones(problem.genome.size, dtype=bool)).terms
    return [axis_of(names[part.genes[0]].partition(".")[0], [names[j] for j in part.genes],
                    part.system, [i for i, j in enumerate(part.genes) if names[j] in chosen],
                    limits_of(problem, part, None)[1], part.pixels) for part in problem.parts()]


def pieces(axis: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Return size and time of some pieces of an axis, each with the inverse of its probability."""
    rng, rows = np.random.default_rng(0), []
    for _ in range(count):
        # A term of the optimum is more often in what is hard to rule out.
        path, weight, room = [], 1.0, axis["room"]
        for j in range(DEPTH):
            share = 0.75 if j in axis["selection"] else 0.35
            taken = bool(rng.random() < share) and room > 0
            if room > 0:
                weight /= share if taken else 1.0 - share
            path.append((j, taken))
            room -= taken
        start = time.process_time()
        nodes = tree_of(axis, 100_000, path)
        written = time.process_time()
        content = json.loads(json.dumps({"schema": "termsel-certificate-1",
                                         "axes": [{**axis, "nodes": nodes}]}))
        with TemporaryDirectory() as folder:
            file = Path(folder) / "piece.json"
            file.write_text(json.dumps({**content, "sha256": checksum(content)}))
            lines, _ = check(file)
            rows.append({"axis": axis["axis"], "weight": weight, "path": path,
                         "steps": len(nodes) - DEPTH, "line": lines[0],
                         "bytes": file.stat().st_size, "write": written - start,
                         "check": time.process_time() - written})
    return rows


if __name__ == "__main__":
    main()
