"""A simulated block as files, to begin with."""

from __future__ import annotations

from pathlib import Path

from termsel import TermselError, write_points_csv, write_rpc
from termsel.toolkit import csv_table, make_folder, write_text
from termsel_block.simulated import simulate_block

_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


def write_example(folder: Path, n_images: int = 3, seed: int = 1, check: int = 0) -> None:
    """Write a simulated block of images with RPCs, of which the first two see six control points.

    `check` is the number of points of each image that judge a selection.

    Raises
    ------
    TermselError
        If the folder exists or cannot be made.
    """
    if folder.exists():
        raise TermselError("this folder exists already" if folder.is_dir() else
                           "a file of this name exists already", file=folder,
                           hint="Name a new folder.")
    simulated = simulate_block(n_images, rpcs=True, control=(6, 6), wrong=0.05, seed=seed,
                               independent=30, check=check)
    block = simulated.block
    # A, B, ... Z, A1, B1, ...: short names for as many images as are asked for.
    names = [_LETTERS[i % 26] + str(i // 26 or "") for i in range(n_images)]
    make_folder(folder, "Name another.")
    text = [f'crs = "{block.crs}"', 'ties = "ties.csv"', ""]
    for name, image in zip(names, block.images, strict=True):
        assert image.rpc is not None
        assert image.features is not None
        write_rpc(image.rpc, folder / f"{name}.RPB")
        write_points_csv(image.features.points, folder / f"{name}_points.csv", block.crs)
        text += ["[[image]]", f'name = "{name}"', f'rpc = "{name}.RPB"',
                 f'points = "{name}_points.csv"', ""]
    # Ties are measured to a thousandth of a pixel, as others write them.
    rows = [["id", "image", "line", "sample"]]
    ties = block.ties
    for tie, image_index, (line, sample) in zip(ties.tie, ties.image, ties.position.tolist(),
                                                strict=True):
        rows.append([ties.names[tie], names[image_index], f"{line:.3f}", f"{sample:.3f}"])
    write_text(folder / "ties.csv", csv_table(rows))
    write_text(folder / "block.toml", "\n".join(text))
