"""What every installed plugin must do, whatever it provides."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, distributions

from termsel.core.isolation.parts import canonical_name
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import Registry
from termsel.testing.cases import Case, Suite, check_declaration, require

SLOW = 3.0
"""Seconds that an import may take."""

_IMPORT = """
import os, random, sys, time, warnings
import numpy as np
import termsel.runs, termsel.plugins.builtin
for name in termsel.__all__: getattr(termsel, name)
def state():
    return {"the working folder": os.getcwd(), "the filters of warnings": warnings.filters[:],
            "numpy's error handling": np.geterr(), "the random numbers": random.getstate(),
            "numpy's random numbers": np.random.get_state()[1].tolist()}
before, start = state(), time.perf_counter()
__import__(sys.argv[1])
seconds, after = time.perf_counter() - start, state()
print("\\n", [name for name in before if before[name] != after[name]], seconds, sep="\\n")
"""


@dataclass(frozen=True)
class Installed:
    """A distribution with plugins."""

    name: str

    @cached_property
    def registry(self) -> Registry:
        """The plugins of this distribution, next to those that are built in."""
        points: list[EntryPoint] = []
        for distribution in distributions():
            if canonical_name(distribution.name) == canonical_name(self.name):
                points += distribution.entry_points.select(group=PROJECT)
                # Of a distribution that is found twice, Python imports the first.
                break
        return Registry(points)

    def modules(self) -> list[str]:
        """Return the modules of its entry points."""
        # The first slot is that of what is built in.
        return sorted({slot.module for slot in self.registry.slots[1:]})


def installed(plugin: Installed) -> None:
    """It is installed, with an entry point in the group termsel."""
    names = {canonical_name(distribution.name) for distribution in distributions()}
    require(canonical_name(plugin.name) in names, f"{plugin.name} is not installed: pip install .")
    require(plugin.modules(), f"{plugin.name} has no entry point in the group {PROJECT!r}")


def loads(plugin: Installed) -> None:
    """It is imported, all its hooks work, and nothing of it is refused."""
    failures = plugin.registry.failures()
    require(not failures, "; ".join(map(str, failures)))


def provides(plugin: Installed) -> None:
    """It implements a hook, and what it provides says what it is."""
    # A package that is found and implements nothing is a mistake of its hooks' names.
    require(any(loaded.hooks for loaded in plugin.registry.plugins[1:]), "it implements no hook")
    for kind in KINDS:
        for entry in plugin.registry.entries(kind):
            if entry.provided_by == canonical_name(plugin.name):
                check_declaration(kind, entry.object)


def modest_import(plugin: Installed) -> None:
    """Its import is quick, prints nothing and changes nothing of the process."""
    for module in plugin.modules():
        # In a new interpreter, since nothing is imported twice.
        done = subprocess.run([sys.executable, "-P", "-c", _IMPORT, module], text=True,
                              capture_output=True, check=False)
        require(done.returncode == 0, f"{module} cannot be imported: {done.stderr[-500:]}")
        # The last two lines are the script's own; what comes before was printed by the import.
        *printed, changed, seconds = done.stdout.strip().splitlines()
        require(not "".join(printed).strip(), f"the import of {module} prints {printed}")
        require(changed == "[]", f"the import of {module} changes {changed}")
        require(float(seconds) < SLOW, f"the import of {module} takes {float(seconds):.1f} s; "
                                       "import slow modules inside functions")


def cases(distribution: str) -> list[Case]:
    """Return an installed distribution by its name."""
    return [Case(distribution, lambda: Installed(distribution))]


SUITE = Suite((installed, loads, provides, modest_import), cases)
