"""The order of the rooms: which part of termsel may import which.

Fifteen rooms stand on the road, from `cli` down to `core`; `toolkit` and `testing` stand beside it,
for authors of packages. `ROOMS` is the one place that states the order. A room imports from those
below it and never from one above; `python -m tests.lint` holds every import against this list.
"""

from __future__ import annotations

ROOMS = {
    "__main__": "entry of the command line",
    "toolkit": "what packages build on next to the names of termsel",
    "testing": "conformance suites for every kind of thing that plugins provide",
    "cli": "commands, one module each",
    "studies": "many runs: cells, journal, executors, tables",
    "runs": "one run: what is asked, the fit, its assessment",
    "io": "verbs on files: read, export, project, rectify, the folder of a result",
    "plugins": "hooks, kinds of things, loading, registry, what is built in",
    "simulate": "scenes with known truth",
    "formats": "file formats: readers, writers and what they share",
    "results": "the result of a run, and what people see of it: text, charts, pages",
    "auto": "models fitted without a search, and the choice among them",
    "selection": "which terms and features: problems, criteria, solvers, best subsets",
    "fitting": "one fitted model: estimators, figures, residuals, diagnosis, accuracy",
    "models": "ground to image as named terms; poles, RPCs; image to ground",
    "adjustment": "equations, least squares, kernels, leave-one-out; estimates under a prior",
    "data": "features, roles, coordinates, scaling, tables, rasters; the record of a run",
    "core": "errors, options, files, isolation of plugins, display, threads",
    "check": "a module: certificates of proofs, by integers alone; it imports no room",
    "rooms": "a module: this list",
}
"""Rooms from top to bottom, with what each holds."""
