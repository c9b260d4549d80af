"""Simulated scenes with the numbers of points of the papers' tables."""

from __future__ import annotations

from functools import partial

from termsel import DatasetSpec, simulate_scene
from termsel.simulate import kept_features

_INDEPENDENT = 100
"""Points in addition to those of the papers, which show the accuracy."""

_COUNTS = (
    ("ikonos-hamedan", 63, 31, "Valadan Zoej et al. 2002, table 1"),
    ("ikonos-hamedan", 20, 74, "Valadan Zoej et al. 2002, table 2"),
    ("irs1c-mashad", 40, 22, "Valadan Zoej et al. 2002, table 3"),
    ("ikonos-hamedan", 27, 47, "Zakaryaie Nejad et al. 2015, table 1"),
    ("ikonos-hamedan", 35, 39, "Zakaryaie Nejad et al. 2015, tables 1 and 3"),
    ("spot-isfahan", 18, 17, "Zakaryaie Nejad et al. 2015, table 2"),
    ("spot-isfahan", 25, 10, "Zakaryaie Nejad et al. 2015, table 2"),
)
"""Scene, control points, check points, and where these numbers are from."""

SIMULATED = {
    f"{scene}-{control}-{check}":
        partial(simulate_scene, scene, roles=(control, check, _INDEPENDENT), n_lines=0)
    for scene, control, check, _ in _COUNTS}
"""What simulates each scene, by its name; the package keeps what came of it."""

# They are read from files of the package, not simulated, so that every machine has the same digits.
DATASETS = [
    DatasetSpec(f"{scene}-{control}-{check}",
                f"simulated scene {scene}: {control} control and {check} selection points as in "
                f"{source}; {_INDEPENDENT} independent ones",
                partial(kept_features, "termsel_optimisers.papers", f"{scene}-{control}-{check}"),
                simulated=True)
    for scene, control, check, source in _COUNTS]
