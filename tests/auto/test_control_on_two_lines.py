"""Control on two lines of the image shows no curvature across them."""

import numpy as np
import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit

SIZE = np.array([900.0, 1000.0])


def on_two_columns(seed: int, rows: int, noise: float) -> tuple[Fit, np.ndarray, np.ndarray]:
    """Return the chosen fit of a bent image with control at its edges, and other places in it."""
    rng = np.random.default_rng([6, seed])
    angle = rng.uniform(0.0, 2 * np.pi)
    bend = rng.uniform(-0.1, 0.1, 4)

    def ground_of(image: np.ndarray) -> np.ndarray:
        v, u = ((image - SIZE / 2) / 1000.0).T
        x, y = u + bend[0] * u**2 + bend[1] * u * v, v + bend[2] * v**2 + bend[3] * u * v
        turned = np.stack([x * np.cos(angle) + y * np.sin(angle),
                           x * np.sin(angle) - y * np.cos(angle)], axis=1)
        return np.column_stack([2e4 * turned + [5e5, 5e6], np.full(len(image), np.nan)])

    line, sample = np.meshgrid(np.linspace(0.0, SIZE[0], rows), [0.0, SIZE[1]])
    image = np.column_stack([line.ravel(), sample.ravel()])
    places = rng.uniform(0.0, 1.0, (200, 2)) * SIZE
    points = termsel.Points(tuple(map(str, range(2 * rows))),
                            image + rng.normal(0.0, noise, image.shape), ground_of(image))
    chosen = Auto().choose(FitData.of(termsel.FeatureSet(points, crs="EPSG:32633")))
    assert chosen is not None
    return chosen.chosen, ground_of(places), places


@pytest.mark.parametrize("rows", [9, 14])
def test_exact_points_do_not_send_the_map_out_of_the_image(rows: int) -> None:
    # Errors held out were thousandths of a pixel, and places between thousands of pixels away.
    for seed in range(4):
        fitted, ground, image = on_two_columns(seed, rows, 0.0)
        errors = np.linalg.norm(fitted.project(ground) - image, axis=1)
        assert np.sqrt((errors**2).mean()) < 200.0


@pytest.mark.parametrize("rows", [11, 20])
def test_sigma_between_the_lines_is_of_the_size_of_what_the_points_show(rows: int) -> None:
    # A square across the lines was as free as could be: thousands of pixels were stated for 20.
    ratios = []
    for seed in range(6):
        fitted, ground, image = on_two_columns(seed, rows, 0.3)
        errors = np.abs(fitted.project(ground) - image)
        ratios.append(np.sqrt((errors**2).sum() / (fitted.sigma(ground) ** 2).sum()))
    assert 0.15 < np.median(ratios) < 1.5
