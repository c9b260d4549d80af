"""Compute the simulated data sets that are kept as files.

``python -m benchmarks.embedded`` in a clone writes them once more, as after a change of a scene.
All figures of the documentation that are made of these scenes then change, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from termsel import FeatureSet, simulate_scene
from termsel.formats.rpc_files import write_rpc
from termsel.simulate.catalogue import OTHERS, SCENES
from termsel.simulate.example import vendor_rpc
from termsel.simulate.kept import FOLDER, bytes_to_keep
from termsel_optimisers.papers.datasets import SIMULATED
from termsel_rpc.simulated import DATASET_NAME, MATCHES, simulate_candidates, simulate_matches

ROOT = Path(__file__).parents[1]
CORE = ROOT / "src" / "termsel" / "simulate" / FOLDER
PLUGINS = ROOT / "plugins"


def computed() -> Iterator[tuple[Path, FeatureSet]]:
    """Yield every data set, as this processor computes it, and the file that keeps it."""
    for name in (*SCENES, *OTHERS):
        yield CORE / f"{name}.json", simulate_scene(name)
    for i in range(1, 6):
        yield CORE / f"image-{i}.json", simulate_scene(
            "spot-isfahan", seed=i, n_points=30, n_lines=0)
    papers = PLUGINS / "termsel-optimisers" / "src" / "termsel_optimisers" / "papers" / FOLDER
    for name, simulated in SIMULATED.items():
        yield papers / f"{name}.json", simulated()
    rpc = PLUGINS / "termsel-rpc" / "src" / "termsel_rpc" / FOLDER
    yield rpc / f"{DATASET_NAME}.json", simulate_candidates()
    yield rpc / f"{MATCHES}.json", simulate_matches()


def main() -> None:
    """Write all."""
    for path, features in computed():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(bytes_to_keep(features))
    write_rpc(vendor_rpc(), CORE / "vendor.RPB")


if __name__ == "__main__":
    main()
