"""Features without a height among others that have one: left out of models that use heights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from termsel.core.errors import counted, first_of
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData, carriers


def to_leave_out(features: FeatureSet) -> tuple[str, ...]:
    """Return the features without a height, where a model that uses heights is still possible.

    None where all have heights, most have none, or heights tell nothing. Those that are off take no
    part.
    """
    off = {name for name, role in zip(features.points.ids, features.points.roles, strict=True)
           if role == "off"}
    missing = [name for name in features.without_height() if name not in off]
    if not missing:
        return ()
    # What remains must tell what a height does, or leaving others out gains nothing.
    with_heights = features.take(~np.isin(features.ids, [*missing, *off]))
    # Independent points must not decide what is fitted.
    deciding = with_heights.with_(points=with_heights.points.take(
        [role != "independent" for role in with_heights.points.roles]))
    return tuple(missing) if len(with_heights) > len(missing) and len(deciding) \
        and not carriers(FitData.of(deciding, heights=False)) else ()


def note_on_blank(ids: Sequence[str], features: FeatureSet) -> str:
    """Return the note on features, of those as read, that were left out for want of a height."""
    named = first_of(ids)
    is_one = len(ids) == 1
    takes, heights, them = ("takes", "its height", "it") if is_one else (
        "take", "their heights", "them")
    return (f"{counted(len(ids), features.word[:-1])} without a height {takes} no part, as the "
            f"model uses heights: {named}. Give {heights}, or take {them} from a raster (--dem "
            "FILE). A plane model (--model poly2d) requires none.")
