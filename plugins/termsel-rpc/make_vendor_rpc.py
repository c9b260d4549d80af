"""Make the RPC of the embedded data set from its nominal sensor, as vendors make theirs.

    python plugins/termsel-rpc/make_vendor_rpc.py
"""

from __future__ import annotations

import numpy as np

from termsel import FeatureSet, LeastSquares, Points, RationalFunctions, rpc_of
from termsel.toolkit import make_scaling
from termsel.toolkit.files import rpb_text
from termsel_rpc.simulated import RPC_FILE, nominal_sensor

# Heights above the ellipsoid between which the RPC is fitted [m].
LOWEST, HIGHEST = 1650.0, 2050.0


def main() -> None:
    """Fit an RPC to a grid of image positions at seven heights, and write it to `RPC_FILE`.

    All 78 terms are fitted, and the largest distance from the sensor is printed.
    """
    sensor = nominal_sensor()
    grid = np.stack(np.meshgrid(np.linspace(0, sensor.n_lines - 1, 21),
                                np.linspace(0, sensor.n_samples - 1, 21),
                                np.linspace(LOWEST, HIGHEST, 7)), axis=-1).reshape(-1, 3)
    ground = np.column_stack([sensor.locate(grid[:, :2], grid[:, 2]), grid[:, 2]])
    control = FeatureSet(Points(tuple(map(str, range(len(grid)))), grid[:, :2], ground),
                         crs="EPSG:4979", image_size=(sensor.n_lines, sensor.n_samples))
    model = RationalFunctions()
    exported = rpc_of(LeastSquares().fit(model, control, make_scaling(control), *(
        np.ones(n, dtype=bool) for n in (len(model.terms), len(control)))))
    RPC_FILE.write_text(rpb_text(exported.rpc.as_delivered()))
    away = exported.rpc.project(ground) - grid[:, :2]
    print(f"{exported.how}: at most {np.abs(away).max():.2g} px from the sensor")


if __name__ == "__main__":
    main()
