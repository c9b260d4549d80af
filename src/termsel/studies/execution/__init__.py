"""How cells are run: processes, clusters, progress, interruption."""
