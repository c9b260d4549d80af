"""The order of the rooms: which part of termsel may import which.

`ROOMS` is the one place that states it. A room imports from those below it and never from one
above; `python -m tests.lint` holds every import against this list.
"""

from __future__ import annotations

ROOMS = {
    "__main__": "entry of the command line",
    "toolkit": "what packages build on next to the names of termsel",
    "testing": "conformance suites for every kind of thing that plugins provide",
    "cli": "commands, one module each",
    "check": "certificates of proofs, by integers alone; it imports no other room",
    "studies": "many runs: cells, journal, executors, tables",
    "runs": "one run: task, search, choice, assessment, judgement",
    "io": "verbs on files: read, export, project, rectify, the folder of a result",
    "plugins": "hooks, kinds of things, loading, registry, what is built in",
    "simulate": "scenes with known truth",
    "formats": "file formats: readers, writers and what they share",
    "results": "the record of a run, its checksums",
    "report": "what people see of a record: text, charts, pages",
    "solvers": "search: ledger, budget, and the solvers",
    "problems": "genes to objectives: selection, constraints, enumeration, recipes",
    "candidates": "models fitted without a search, and the choice among them",
    "criteria": "figures of merit of a population of fits",
    "models": "ground to image as named terms; poles, RPCs",
    "fits": "one fitted model: estimators, figures, residuals, diagnosis, inversion",
    "priors": "estimates under a prior: shrunken polynomials, fields, splines, blunder odds",
    "enumeration": "best subsets of terms or features by branch and bound",
    "adjustment": "equations, least squares, kernels, leave-one-out",
    "files": "files: found, opened, written whole or not at all; rasters; what is remote",
    "measurements": "features, roles, areas, coordinates, scaling, data sets",
    "record": "the typed record of a run: what result.json holds, and its schema",
    "options": "typed, documented options",
    "guard": "calls into plugins: faults, checks of what they return, limits of time",
    "display": "values at one glance, in a terminal and in notebooks",
    "threads": "threads of linear algebra",
    "interrupts": "Ctrl-C that is not lost",
    "errors": "what the user can correct",
    "version": "the version of termsel",
    "rooms": "this list",
}
"""Rooms from top to bottom, with what each holds."""
