"""Write a block: a folder for each image that every command reads, and the files of the whole."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path

import msgspec
import numpy as np

from termsel import FeatureSet, Points, Result, TermselError, require_replaceable, run, write_result
from termsel.toolkit import csv_table, one_blas_thread, write_text
from termsel.toolkit.models import Predicted, pixel_on_ground
from termsel_block.accuracy import shared_sigma
from termsel_block.block import BlockImage
from termsel_block.files.placing import place_together
from termsel_block.geometry.physical import PhysicalCamera
from termsel_block.joint import BlockResult
from termsel_block.shown.page import page_of
from termsel_block.shown.record import (
    BlockRecord,
    block_schema,
    correction_of,
    record_as_written,
    record_of,
    times_seen,
)
from termsel_block.shown.summary import text_of

log = logging.getLogger("termsel.block")

RECORD, SUMMARY, PAGE, TIES, SCHEMA_FILE = _FILES = (
    "block.json", "summary.txt", "report.html", "ties.csv", "block.schema.json")

_MAX_TIES = {"smooth": 400, "polynomial": 200}
_MAX_TIES_PHYSICAL, _MAX_TIES_OTHERS = 40, 120
"""Ties of an image that its own result keeps as control, by its model: with more it is the block's
model no better than a tenth of what the block predicts, and takes longer.
"""

_WITHOUT_BLUNDER_TEST = {"tested": True}
"""Option of a run whose control and ties the block has looked at for blunders."""

_INTERVALS, _PER_INTERVAL = 32, 5
"""Intervals of the splines that follow jitter as the block has it, and points that each takes."""


def require_free_folder(folder: Path, names: list[str], *, overwrite: bool,
                        reads: Iterable[Path] = ()) -> None:
    """Require that a block can be written to a folder, before any long computation.

    Parameters
    ----------
    folder : Path
        The folder that a block is to be written into.
    names : list of str
        Names of the images.
    overwrite : bool
        Whether a block in the folder may be replaced.
    reads : iterable of Path
        Files that the run reads, which are not replaced.

    Raises
    ------
    TermselError
        If the folder holds a block (without `overwrite`), holds a file that the block would replace
        and that is not part of one, or that the run reads, or cannot be made; or if an image has
        the name of a file of the block.
    """
    reserved = [name for name in names if name.casefold() in _FILES]
    if reserved:
        raise TermselError(f"{reserved[0]!r} cannot be the name of an image: the block has a file "
                           "of that name", hint="Give the image another name.")
    require_replaceable([folder / name for name in _FILES], reads=reads, overwrite=True,
                        makes_folder=True)
    if (folder / RECORD).exists() and not overwrite:
        raise TermselError("there is a block in this folder already", file=folder,
                           hint="Choose another --out, or add --overwrite.")
    # A file of such a name without a block next to it is not termsel's.
    foreign = [name for name in _FILES
               if (folder / name).exists() and not (folder / RECORD).exists()]
    if foreign:
        raise TermselError("the block would replace this file, which is not part of one",
                           file=folder / foreign[0], hint="Choose another --out.")
    existing = [name for name in names if (folder / name).exists() and not overwrite]
    if existing:
        raise TermselError("the result of an image would replace this", file=folder / existing[0],
                           hint="Choose another --out, or add --overwrite.")
    # The folder is made in the nearest one above it that exists.
    existing_parent = next(parent for parent in folder.absolute().parents if parent.exists())
    if (folder.exists() and not folder.is_dir()) or not os.access(existing_parent, os.W_OK):
        raise TermselError("cannot make this folder", file=folder, hint="Choose another --out.")


@one_blas_thread
def write_block(result: BlockResult, folder: Path | str, *, overwrite: bool = False,
                progress: Callable[[float], None] | None = None) -> BlockRecord:
    """Write the results of all images, then the block's own files.

    Parameters
    ----------
    result : BlockResult
        The block as `adjust` returns it.
    folder : path-like
        Each image gets a folder of its name in it. The block has block.json with its schema,
        summary.txt, report.html, and ties.csv with the places of the ties.
    overwrite : bool
        Whether a block that is there may be replaced.
    progress : callable, optional
        Called with the share that is done.

    Returns
    -------
    BlockRecord
        What block.json holds.

    Raises
    ------
    TermselError
        As `require_free_folder`, or if a file cannot be written. Then nothing has changed.

    Notes
    -----
    Numbers come first: report.html is drawn once they are in the folder. Pictures that cannot be
    drawn, and a page that cannot be written, are told by warnings.

    Examples
    --------
    >>> from termsel.testing import invoke
    >>> from termsel_block import adjust, read_block, write_block
    >>> written = invoke("block-example", "scene")
    >>> record = write_block(adjust(read_block("scene/block.toml")), "adjusted")
    >>> [image.name for image in record.images]
    ['A', 'B', 'C']
    """
    folder = Path(folder)
    names = [image.name for image in result.block.images]
    # Refused before the pages of work that follow.
    require_free_folder(folder, names, overwrite=overwrite)
    record = record_of(result)
    with place_together(folder, RECORD) as new_folder:
        image_results = []
        for i, name in enumerate(names):
            (new_folder / name).mkdir()
            image_results.append(image_result(result, i, record))
            write_result(image_results[-1], new_folder / name)
            if progress is not None:
                progress((i + 1) / len(names))
        # What is said of an image is what its folder holds.
        record = record_as_written(record, image_results)
        for file, text in {
                TIES: ties_csv(result), SUMMARY: text_of(record),
                SCHEMA_FILE: json.dumps(block_schema(), indent=1) + "\n",
                RECORD: msgspec.json.format(msgspec.json.encode(record), indent=1).decode() + "\n",
                }.items():
            write_text(new_folder / file, text)
    _write_page(result, record, folder / PAGE)
    return record


def _write_page(result: BlockResult, record: BlockRecord, path: Path) -> None:
    """Write the page of a block; if it cannot be drawn, warn, and remove that of an earlier block.
    """
    try:
        write_text(path, page_of(result, record))
    except (TermselError, MemoryError) as error:
        why = error.what if isinstance(error, TermselError) else "out of memory"
        log.warning("Warning: %s is missing: %s. All else is there.", path, why.rstrip("."))
        if not path.is_symlink():
            path.unlink(missing_ok=True)


def image_result(result: BlockResult, i: int, record: BlockRecord) -> Result:
    """Return an image's own result: its model, fitted to its control and to its adjusted ties.

    But for the priors, that fit has the block's parameters. Blunders are not looked for again.
    Since one image does not show what errors its ties have in common, the result states the RMSE
    that the block predicts.
    """
    image = result.block.images[i]
    state = result.adjusted.state
    features = _control_and_ties(result, i, image)
    name = correction_of(result, i)
    source = f"image {image.name} of a block"
    if name == "polynomial":
        fitted = run(features=features, source=source, options=_WITHOUT_BLUNDER_TEST)
    elif image.rpc is None:
        fitted = run("rfm-terms", features=features, solver="all-terms", criterion="press",
                    model=name, source=source, options={**image.options, **_WITHOUT_BLUNDER_TEST})
    else:
        rpc = {"file": (image.rpc_file or Path(f"{image.name}.RPB")).name, **asdict(image.rpc)}
        # All terms of the block's correction are estimated again, with ties as control.
        model = f"rpc-{name}"
        options: dict[str, object] = {"rpc": json.dumps(rpc)}
        if name == "none":
            # A result needs a term: the estimated shift is about zero.
            model = "rpc-shift"
        elif name == "smooth":
            model = "rpc-jitter"
            # Splines of as many intervals as the points can hold, next to the affine terms.
            intervals = max(2, min(_INTERVALS, len(features.points) // _PER_INTERVAL))
            options |= {"across": True, "intervals": intervals}
        fitted = run("rfm-terms", features=features, solver="all-terms", criterion="press",
                    model=model, source=source, options={**options, **_WITHOUT_BLUNDER_TEST})
    image_record = record.images[i]
    note = (f"The places of {int(state.in_use[i].sum())} ties come from a block of "
            f"{len(record.images)} images. By the block points in this image have an RMSE of "
            f"{image_record.predicted:.2f} px, with an interval of 90 % from "
            f"{image_record.low:.2f} to {image_record.high:.2f} px. What the ties have in common "
            "is part of that, and of the uncertainty, not of the residuals. Blunders among "
            "control and ties are named by the "
            "block.")
    # The part of the block's covariance that the image's own fit does not have.
    shared = shared_sigma(result, i, features, fitted.sigma(features.points.ground))
    return fitted.with_(notes=(note, *fitted.notes), shared_sigma=shared,
                   predicted=Predicted(image_record.predicted, image_record.low, image_record.high,
                                       pixel=pixel_on_ground(fitted.fit)))


def _control_and_ties(result: BlockResult, i: int, image: BlockImage) -> FeatureSet:
    """Return the features of an image, with its ties in use as control points.

    Ties are at their adjusted positions, at most as many as its model takes in good time. Points
    that the block rejected have the role off, and such lines are left out.
    """
    state = result.adjusted.state
    ties = result.block.ties
    in_image = np.flatnonzero(ties.image == i)[state.in_use[i]]
    if isinstance(result.camera(i), PhysicalCamera):
        most_ties = _MAX_TIES_PHYSICAL
    else:
        most_ties = _MAX_TIES.get(correction_of(result, i), _MAX_TIES_OTHERS)
    if len(in_image) > most_ties:
        in_image = in_image[np.linspace(0, len(in_image) - 1, most_ties).astype(int)]
    # Names of ties may be those of control points.
    names = [f"tie-{ties.names[k]}" for k in ties.tie[in_image]]
    n = len(names)
    tie_points = Points(tuple(names), ties.position[in_image], result.ties[ties.tie[in_image]],
                        np.full((n, 2), state.sigma_ties), ("control",) * n)
    size = image.size
    if image.features is None:
        return FeatureSet(tie_points, crs=result.block.crs, image_size=size)
    rejected = {name for name, used in zip(result.control[i].feature, state.control_in_use[i],
                                           strict=True) if not used}
    points = image.features.points
    lines = image.features.lines
    roles = tuple("off" if name in rejected else role or "control"
                  for name, role in zip(points.ids, points.roles, strict=True))
    sigma = np.full((len(points), 2), state.sigma_control)
    if points.sigma is not None:
        sigma = points.sigma
    points = replace(points, sigma=sigma, roles=roles)
    lines = lines.take([name not in rejected for name in lines.ids])
    return FeatureSet(points.join(tie_points), lines, crs=result.block.crs,
                      image_size=size or image.features.image_size)


def ties_csv(result: BlockResult) -> str:
    """Return the positions of ties, with their standard deviations [m], as CSV.

    Ties that are in use in fewer than two images have no position, and are left out.
    """
    rows: list[list[object]] = [["id", "x", "y", "z", "sigma_east", "sigma_north", "sigma_up",
                                 "images"]]
    for name, ground, sigma, n in zip(
            result.block.ties.names, result.ties.tolist(), result.sigma_ties.tolist(),
            times_seen(result).tolist(), strict=True):
        if n > 1:
            rows.append([name, *(f"{value:.10g}" for value in ground),
                         *(f"{value:.4g}" for value in sigma), n])
    return csv_table(rows)
