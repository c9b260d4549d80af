"""An RPC that was fitted to points, given to a run with these very points."""

from __future__ import annotations

import numpy as np
from msgspec import convert, json

from termsel.core.errors import TermselError, count_in_words
from termsel.data.coordinates.crs import to_wgs84
from termsel.data.features import FloatArray
from termsel.data.fingerprints import are_remaining_makers, is_cut, makers_of
from termsel.data.record.record import RpcNumbers
from termsel.data.roles import Observations
from termsel.data.rpc import Rpc
from termsel.formats.rpc_files import note_use
from termsel.models.base import SensorModel

_FEWEST_TO_DOUBT = 4
_CHANCE = 5e-4
"""Share of vendors' RPCs that one test doubts although they do not know the points.

There are two tests on each of two sets of points, so that at most four times as many are doubted.
"""
_FINEST = 0.01
"""RMSE that no measurements have [px]."""
_NAMED = 6
"""Ids in a message."""
_COUNT = "control_count"

_FITTED = "The RPC fits these points as if it had been fitted to them"
_WITHOUT_RECORD = "The RPC was fitted by termsel"
RPC_DOUBTS = (_FITTED, _WITHOUT_RECORD)
"""Beginnings of the notes on an RPC whose accuracy cannot be believed."""


def rpc_of_model(model: SensorModel) -> Rpc | None:
    """Return the RPC that a model has as an option, with its numbers in JSON; None if it has none.
    """
    text = model.options.get("rpc")
    if not isinstance(text, str) or _COUNT not in text:
        return None
    numbers = json.decode(text)
    # Earlier records, and those of blocks, have further keys.
    return Rpc.from_numbers(convert({name: numbers[name] for name in RpcNumbers.__struct_fields__
                                     if name in numbers}, RpcNumbers))


def refuse_makers(rpc: Rpc, observations: Observations) -> None:
    """Refuse points that an RPC was fitted to: they can neither correct nor test it.

    Parameters
    ----------
    rpc : Rpc
        Of a file or of the model. One that termsel exported has digests of its control.
    observations : Observations
        Its control, selection and independent points are compared with the digests; where only
        points that are off made it, its use is noted.

    Raises
    ------
    TermselError
        If it was fitted to some of the points, naming these, or seems to be from the rest of them.
    """
    if not rpc.control_digests:
        return
    features = observations.together
    features = features.with_(points=features.points.join_unchecked(observations.independent))
    makers = makers_of(rpc, features)
    hint = ("Give the vendor's RPC in its place, or none (without --rpc one that termsel exported "
            "is not used)")
    name = rpc.source or "that is given"
    if are_remaining_makers(rpc, features):
        raise TermselError(
            f"the RPC {name} was fitted by termsel to {rpc.control_count} features, and these "
            f"{len(features)} seem to be the rest of them, without those that are recognised. They "
            "would seem to confirm it, and all accuracy stated from them would be too good",
            hint=f"{hint}.")
    if not makers:
        if makers_of(rpc, observations.features):
            note_use(rpc)
        return
    named = ", ".join(makers[:_NAMED]) + (", ..." if len(makers) > _NAMED else "")
    # Those that are not recognised may be makers as well: without the recognised ones the others
    # would test it.
    at_least = "at least " if is_cut(rpc) else ""
    hint += "." if is_cut(rpc) else "; or give other points, and these the role off."
    raise TermselError(
        f"the RPC {name} was fitted by termsel to {at_least}{len(makers)} of these "
        f"{len(features)} {features.word} ({named}). They would seem to confirm it, and all "
        "accuracy stated from them would be too good", hint=hint, ids=makers)


def doubt_of_rpc(observations: Observations) -> str:
    """Return why the accuracy of an RPC cannot be believed, or ""."""
    rpc = observations.together.rpc
    lost = "" if rpc is None else rpc_without_record(rpc)
    return lost or doubt_of_fitted_rpc(observations)


def rpc_without_record(rpc: Rpc) -> str:
    """Return the doubt of an RPC whose file lost the list of its control, or "".

    Such a file still says that termsel fitted the RPC, to how many points and no longer to which.
    """
    if not rpc.control_count or rpc.control_digests:
        return ""
    return (f"{_WITHOUT_RECORD} to {count_in_words(rpc.control_count, 'control point')} that "
            "its file no longer names: if these points are among them, the accuracy stated is too "
            "good. Give the RPC that the vendor delivered, or the file that termsel wrote.")


def doubt_of_fitted_rpc(observations: Observations) -> str:
    """Return that an RPC seems to have been fitted to the points that are to test it, or "".

    An RPC as a vendor delivers it is some px off. One that leaves nothing of a shift, or of an
    affine correction, was adjusted to these very points, so that they cannot test it.
    """
    for features in (observations.together, observations.control):
        rpc = features.rpc
        points = features.points.take(np.isfinite(features.points.ground).all(axis=1))
        if rpc is None or len(points) < _FEWEST_TO_DOUBT:
            continue
        image = rpc.project(to_wgs84(features.crs)(points.ground))
        errors = points.image - image
        # The two corrections that programs adjust an RPC by.
        shift = np.ones((len(image), 1))
        affine = np.column_stack([shift, image - image.mean(axis=0)])
        rmse = float(np.sqrt((errors**2).sum(axis=1).mean()))
        if rmse < _FINEST or _is_taken_away(shift, errors) or _is_taken_away(affine, errors):
            return (f"{_FITTED}: "
                    f"{rmse:.2g} px at {len(errors)} points as delivered, without any shift. If "
                    "so, they cannot test it, and the accuracy stated is too good. Give the RPC "
                    "that the vendor delivered.")
    return ""


def _is_taken_away(columns: FloatArray, errors: FloatArray) -> bool:
    """Return whether a correction was taken away from errors (n, 2) before, by least squares.

    `columns` (n, k) are those of the correction, such as a shift. Errors of an RPC that does not
    know the points have some shift and drift, if only by chance. Those that least squares leave
    have none: the sum of squares that a correction takes away is then too small, by the lower tail
    of the F distribution.
    """
    from scipy.special import fdtr  # other runs need not import it

    corrected = errors - columns @ np.linalg.lstsq(columns, errors, rcond=None)[0]
    remaining_squares = float((corrected**2).sum())
    if remaining_squares == 0.0:  # all of the errors is a correction
        return False
    n_coefficients = 2 * columns.shape[1]
    freedom = errors.size - n_coefficients
    # F = mean square that the correction takes away / mean square that remains.
    removed_squares = float((errors**2).sum()) - remaining_squares
    f_ratio = removed_squares / n_coefficients / (remaining_squares / freedom)
    return bool(fdtr(n_coefficients, freedom, f_ratio) < _CHANCE)
