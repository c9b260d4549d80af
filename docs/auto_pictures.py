"""Draw the pictures of the pages on the strategy auto: python docs/auto_pictures.py

Each is a chart of an actual run on the files of `termsel example`.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from gallery import small

import termsel
from termsel.io.example import write_example
from termsel.results.plots import save

TARGET = Path(__file__).parent / "_static"
PICTURES = {
    "auto-candidates": ("points.csv", "candidates"),
    "auto-outliers": ("images/image-3.csv", "residuals"),
    "auto-accuracy": ("gcps.csv", "sigma"),
}
"""For each picture the points it is of, and the chart."""


def main() -> None:
    """Run termsel on each file, and draw its chart."""
    with TemporaryDirectory() as name:
        folder = Path(name) / "files"
        write_example(folder)
        for picture, (points, kind) in PICTURES.items():
            result = termsel.run(features=termsel.read(folder / points))
            path = TARGET / f"{picture}.svg"
            save(getattr(result.plot, kind)(), path)
            path.write_text(small(path.read_text("utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
