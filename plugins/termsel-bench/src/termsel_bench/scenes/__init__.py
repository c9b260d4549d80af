"""The sets of the benchmark: simulated ones with frozen splits, and real ones of a folder."""
