"""Studies on the workers of a dask scheduler."""

from collections.abc import Iterable

from termsel import hookimpl
from termsel.toolkit import Part
from termsel_cluster.cluster import on_cluster

__all__ = ["on_cluster"]


@hookimpl
def termsel_parts() -> Iterable[Part]:
    """Return what runs cells on the workers of a scheduler."""
    return [Part("scheduler", on_cluster)]
