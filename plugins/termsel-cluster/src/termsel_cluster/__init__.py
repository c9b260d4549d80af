"""Studies on the workers of a dask scheduler."""

from termsel_cluster.cluster import on_cluster

__all__ = ["on_cluster"]
