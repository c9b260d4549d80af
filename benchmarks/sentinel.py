"""How exact the ways from a Sentinel-1 image to the ground are, with range and Doppler as truth.

``python -m benchmarks.sentinel --write`` makes docs/evidence/sentinel-1.md from the annotations in
real/sentinel1 of the data folder; without these it says so, and changes nothing. With ``--whole``
it also times `rectify` and gdalwarp on an image of the size of the first GRD product, which takes
half an hour.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, RBFInterpolator

import termsel
from benchmarks.radar_maps import beside
from benchmarks.sets import DATA, put
from benchmarks.whole_image import timings
from termsel.core.threads import one_blas_thread
from termsel.data.coordinates.wgs84 import to_ecef
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.fitting.rpc_fit import rpc_of
from termsel_cameras import Radar
from termsel_cameras.scanners.annotation import Annotation, LatticePoint, annotation_of, lattice_of
from termsel_cameras.scanners.radar import zero_doppler

PLACES, SEED = 1500, 0
LIGHT = 299792458.0
NEARER = 12
"""Steps from a sample by two polynomials to that by the nearest one."""

HALVINGS = 60
"""Of the interval in which the time of zero Doppler lies: to rounding."""

INTRODUCTION = """# Sentinel-1: the ways from image to ground

Files of Sentinel-1 carry GCPs, which their processor computed. Most programs lay a polynomial or a
spline through them and ignore their heights. termsel reads the product with its annotation, and so
has the [radar](../how-to/sentinel-1.md) with orbit and timing.

`python -m benchmarks.sentinel --write` makes this page from annotations of real products (contains
modified Copernicus Sentinel data 2021, 2022).
"""

TRUTH = f"""## Between the points of the lattice

Truth is range and Doppler, computed for this page by halving intervals of time, which the package
does not: at {PLACES:,} places between the lattice's points, at heights of their own between the
lowest and the highest. Figures are RMSE [px]. The interval is what a run on the lattice alone
promises. Of an SLC image of the mode IW it is the first burst, of which the product has no lattice:
termsel computes one.

""" + "\n".join("| " + " | ".join(cells) + " |" for cells in (
    ("image", "GCPs", "heights [m]", "cubic, as gdalwarp -order 3", "spline, as gdalwarp -tps",
     "auto, lattice alone", "promised (90 %)", "radar", "RPC of the radar", "its largest"),
    ("---",) + ("---:",) * 9)) + "\n"

END = """
A cubic or a spline without heights is off by what relief does. Of the stripmap image the lattice
itself is 0.08 px off in line, as the processor takes in when echoes arrive. No RPC follows the
polynomials of ground range, which change every second; the message of the export says how far it is
off.
"""

AGAINST = """
## Against the lattice

How far the radar sees the lattice's own points from where the annotation has them, RMSE [px]. Range
and Doppler alone leave out that an echo from afar arrives later; with `--set bistatic=true` lines
take that in, as the lattice does. Samples of a GRD image follow two polynomials, weighed by time;
those of the lattice that which is nearest in time.

| image | lines | lines, bistatic | samples | samples, nearest polynomial |
|---|---:|---:|---:|---:|
"""

SIBLINGS = """
## Other GRD images, from the lattice alone

*Simulated:* images like the GRD above, whose relief and changes of ground range from second to
second are a share of its own, in another order. Lattices are computed as the annotation's is. The
interval is what a run on the lattice alone promises, the error that against range and Doppler.

| relief | changes | order | error [px] | promised (90 %) |
|---:|---:|---|---:|---:|
"""

MAPS = """
## Maps of other programs, pixel by pixel

The image has its own line and sample as pixels, so that maps by different ways show how far apart
in the image their pixels were taken from. Relief is made up, between the lowest and the highest
point. gdalwarp takes the RPC with the DEM; QGIS takes it at its height offset, and shows the
nearest pixel: its figure is what is beyond half a pixel. Where the RPC is exact, what is left is
how the programs resample, and that QGIS interpolates positions, to an eighth of a pixel by GDAL's
default. Of GRD images both stay within what the export says.

| image | pixels | gdalwarp, RMSE [px] | largest | QGIS, largest | the export says: RMSE | largest |
|---|---:|---:|---:|---:|---:|---:|
"""

SHARES = ((1.0, 1.0), (0.3, 0.3), (0.1, 0.1), (0.05, 0.03))
"""Relief and changes of ground range of simulated images, as shares of those of the real one."""


@dataclass(frozen=True, eq=False)
class Case:
    """An annotation, with the burst of a TOPS image."""

    path: Path
    burst: int

    @property
    def lattice(self) -> tuple[LatticePoint, ...]:
        """Points of the annotation."""
        return lattice_of(self.path)

    def features(self) -> FeatureSet:
        """Return the lattice with its annotation."""
        return termsel.read(self.path, **({"burst": self.burst} if self.burst else {}))


def cases() -> list[Case]:
    """Return the annotations of the data folder."""
    found = []
    for path in sorted((DATA / "real" / "sentinel1").glob("*.xml")):
        bursts = annotation_of(str(path)).bursts
        found.append(Case(path, 1 if bursts else 0))
    return found


def truth(case: Case, ground: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) of places by range and Doppler, by bisection."""
    stated = annotation_of(str(case.path))
    orbit = CubicHermiteSpline(stated.times, stated.positions, stated.velocities)
    motion = CubicSpline(stated.times, stated.velocities)
    targets = to_ecef(ground)
    low = np.full(len(ground), stated.times[0])
    high = np.full(len(ground), stated.times[-1])
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        ahead = ((targets - orbit(middle)) * motion(middle)).sum(axis=1) > 0.0
        low = np.where(ahead, middle, low)
        high = np.where(ahead, high, middle)
    time = (low + high) / 2.0
    distance = np.linalg.norm(targets - orbit(time), axis=1)
    burst = stated.bursts[case.burst - 1] if case.burst else None
    line = time / stated.line_interval if burst is None else \
        burst.line + (time - burst.time) / stated.line_interval
    if not stated.ground_ranges:
        sample = (2.0 * distance / LIGHT - stated.first_range_time) * stated.sampling_rate
        return np.stack([line, sample], axis=1)
    moments = [record.time for record in stated.ground_ranges]
    ranges = np.stack([np.polyval(record.coefficients[::-1], distance - record.origin)
                       for record in stated.ground_ranges], axis=1)
    sample = [np.interp(at, moments, row) for at, row in zip(time, ranges, strict=True)]
    return np.stack([line, np.array(sample) / stated.sample_spacing], axis=1)


def places_between(features: FeatureSet) -> FloatArray:
    """Return places (n, 3) in the meshes of a lattice, at heights of their own."""
    rng = np.random.default_rng(SEED)
    image = features.points.image
    ground = features.points.ground
    lines = np.unique(image[:, 0])
    columns = np.unique(image[:, 1])
    number = {place: index for index, place in enumerate(map(tuple, image.tolist()))}
    found = []
    while len(found) < PLACES:
        row = int(rng.integers(len(lines) - 1))
        column = int(rng.integers(len(columns) - 1))
        corners = [number.get((lines[row + i], columns[column + j])) for i in (0, 1)
                   for j in (0, 1)]
        if None in corners:
            continue
        down, right = rng.uniform(size=2)
        weights = np.outer([1.0 - down, down], [1.0 - right, right]).ravel()
        found.append(weights @ ground[corners])
    places = np.array(found)
    places[:, 2] = rng.uniform(ground[:, 2].min(), ground[:, 2].max(), PLACES)
    return places


def cubic(features: FeatureSet, places: FloatArray) -> FloatArray:
    """Return positions by a cubic polynomial of longitude and latitude."""
    ground = features.points.ground
    middle = ground.mean(axis=0)
    half = np.ptp(ground, axis=0) / 2.0

    def columns(at: FloatArray) -> FloatArray:
        x, y = ((at - middle) / half)[:, :2].T
        return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)

    return columns(places) @ np.linalg.lstsq(columns(ground), features.points.image)[0]


def spline(features: FeatureSet, places: FloatArray) -> FloatArray:
    """Return positions by a thin plate spline through all points."""
    ground = features.points.ground[:, :2]
    middle = ground.mean(axis=0)
    unit = float(np.ptp(ground, axis=0).max())
    through = RBFInterpolator((ground - middle) / unit, features.points.image,
                              kernel="thin_plate_spline")
    return np.asarray(through((places[:, :2] - middle) / unit))


def row(case: Case) -> str:
    """Return the row of an annotation."""
    features = case.features()
    places = places_between(features)
    exact = truth(case, places)

    def rmse(positions: FloatArray) -> str:
        return _size(float(np.sqrt(((positions - exact)**2).sum(axis=1).mean())))

    alone = features.with_(points=replace(features.points, attributes={}))
    result = termsel.run(features=alone)
    promised = result.predicted
    radar = Radar(metadata=str(case.path), burst=case.burst)
    rpc = rpc_of(termsel.run(features=features).fit)
    heights = features.points.ground[:, 2]
    return " | ".join(["", radar.annotation.product + (f", burst {case.burst}" * bool(case.burst)),
                       f"{len(features.points)}", f"{heights.min():.0f} to {heights.max():,.0f}",
                       rmse(cubic(features, places)), rmse(spline(features, places)),
                       rmse(result.fit.project(places)),
                       "-" if promised is None else f"{_size(promised.low)} to "
                       f"{_size(promised.high)}", rmse(radar.unshifted(places)),
                       rmse(rpc.rpc.project(places)), _size(rpc.worst), ""]).strip()


def against_lattice(case: Case) -> str:
    """Return how far the radar sees points of the lattice from where the annotation has them."""
    points = case.lattice
    image = np.array([[point.line, point.sample] for point in points])
    ground = np.array([[point.longitude, point.latitude, point.height] for point in points])
    if case.burst:  # of which the lattice has the first line alone
        ground = ground[image[:, 0] == 0]
        image = image[image[:, 0] == 0]
    radar = Radar(metadata=str(case.path), burst=case.burst)
    plain = radar.unshifted(ground) - image
    late = Radar(metadata=str(case.path), burst=case.burst, bistatic=True).unshifted(ground) - image
    nearest = by_nearest(radar.annotation, ground) - image[:, 1] \
        if radar.annotation.ground_ranges else plain[:, 1]
    figures = (np.sqrt((errors**2).mean()) for errors in (
        plain[:, 0], late[:, 0], plain[:, 1], nearest))
    name = radar.annotation.product + (f", burst {case.burst}" * bool(case.burst))
    return f"| {name} | " + " | ".join(f"{figure:.2g}" for figure in figures) + " |"


def by_nearest(stated: Annotation, ground: FloatArray) -> FloatArray:
    """Return samples (n,) of places by the polynomial of ground range nearest in time."""
    time, distance, _ = zero_doppler(stated, to_ecef(ground))
    moments = np.array([record.time for record in stated.ground_ranges])
    numbers = np.abs(moments[:, None] - time).argmin(axis=0)
    samples = [np.polyval(stated.ground_ranges[number].coefficients[::-1],
                          slant - stated.ground_ranges[number].origin)
               for number, slant in zip(numbers, distance, strict=True)]
    return np.array(samples) / stated.sample_spacing


def siblings(case: Case) -> list[str]:
    """Return the rows of simulated images like a GRD image."""
    stated = annotation_of(str(case.path))
    rows = []
    for order in (None, 1, 2):
        for relief, change in SHARES:
            sibling = like(stated, change, order)
            features = lattice_like(case, sibling, relief)
            places = places_between(features)
            exact = Radar(metadata=sibling.text()).unshifted(places)
            result = termsel.run(features=features)
            error = np.sqrt(((result.fit.project(places) - exact)**2).sum(axis=1).mean())
            promised = result.predicted
            assert promised is not None
            rows.append(f"| {relief:g} | {change:g} | {'its own' if order is None else 'another'} "
                        f"| {_size(float(error))} | {_size(promised.low)} to "
                        f"{_size(promised.high)} |")
    return rows


def like(stated: Annotation, change: float, order: int | None) -> Annotation:
    """Return an annotation whose ground range changes by a share of another's, in some order."""
    records = stated.ground_ranges
    table = np.zeros((len(records), max(len(record.coefficients) for record in records)))
    for row, record in zip(table, records, strict=True):
        row[:len(record.coefficients)] = record.coefficients
    mean = table.mean(axis=0)
    numbers = np.arange(len(records)) if order is None else \
        np.random.default_rng(order).permutation(len(records))
    table = mean + change * (table[numbers] - mean)
    return replace(stated, ground_ranges=tuple(
        replace(record, coefficients=tuple(row.tolist()))
        for record, row in zip(records, table, strict=True)))


def lattice_like(case: Case, stated: Annotation, relief: float) -> FeatureSet:
    """Return the lattice of a simulated image, by polynomials of ground range nearest in time."""
    points = case.lattice
    image = np.array([[point.line, point.sample] for point in points])
    ground = np.array([[point.longitude, point.latitude, relief * point.height]
                       for point in points])
    radar = Radar(metadata=stated.text(), bistatic=True)
    asked = image.copy()
    # The sample by weighed polynomials of the place that the nearest one sees at the lattice's.
    for _ in range(NEARER):
        places = radar.on_ground(asked, ground)
        asked[:, 1] += image[:, 1] - by_nearest(stated, places)
    return FeatureSet(Points(tuple(map(str, range(len(image)))), image, places), crs="EPSG:4979",
                      image_size=stated.size)


def map_row(case: Case) -> str:
    """Return the row of maps by gdalwarp and QGIS next to that of `rectify`."""
    with tempfile.TemporaryDirectory() as folder:
        apart = beside(case.features(), Path(folder))
    figures = (apart.gdal_rms, apart.gdal_largest, apart.qgis_largest, apart.stated_rms,
               apart.stated_largest)
    name = annotation_of(str(case.path)).product + (f", burst {case.burst}" * bool(case.burst))
    return f"| {name} | {apart.pixels:,} | " + " | ".join(
        f"{figure:.2g}" for figure in figures) + " |"


def _size(value: float) -> str:
    return "0" if value < 1e-6 else f"{value:.2g}" if value < 99.5 else f"{value:,.0f}"


@one_blas_thread
def main() -> None:
    """Print the page, or renew it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="renew the page")
    parser.add_argument("--whole", type=float, nargs="?", const=1.0, metavar="SHARE",
                        help="time the map of a whole image, too, or of a share of it")
    asked = parser.parse_args()
    found = cases()
    if not found:
        sys.stdout.write(f"no annotations in {DATA / 'real' / 'sentinel1'}: nothing is done\n")
        return
    text = INTRODUCTION + "\n" + TRUTH
    text += "\n".join(row(case) for case in found) + "\n"
    text += END
    text += AGAINST + "\n".join(map(against_lattice, found)) + "\n"
    grd = next(case for case in found if not case.burst
               and annotation_of(str(case.path)).ground_ranges)
    text += SIBLINGS + "\n".join(siblings(grd)) + "\n"
    if shutil.which("gdalwarp"):
        text += MAPS + "\n".join(map(map_row, found)) + "\n"
    if asked.whole:
        text += "\n" + timings(grd.path, asked.whole)
    put("sentinel-1", text, write=asked.write)


if __name__ == "__main__":
    main()
