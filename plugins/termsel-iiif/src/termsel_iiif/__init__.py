"""Georeference annotations of IIIF images, as a plugin.

References
----------
IIIF Georeference Extension 1.0, https://iiif.io/api/extension/georef/.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl

if TYPE_CHECKING:
    from termsel import Reader, Writer


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return the reader of georeference annotations."""
    from termsel_iiif.reader import AnnotationReader

    return [AnnotationReader]


@hookimpl
def termsel_writers() -> Iterable[type[Writer]]:
    """Return the writer of georeference annotations."""
    from termsel_iiif.writer import AnnotationWriter

    return [AnnotationWriter]
