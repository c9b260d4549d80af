"""How far it is from what a user gives to what the program does with it: functions and modules.

``python -m tests.walks`` runs four things that a user does under ``sys.setprofile`` and counts the
functions of termsel that take part, each once. A function that only ever runs inside of numpy,
numba or a library is none; comprehensions and lambdas belong to the function around them.
``--names`` lists them. Figures are those of a warm process: what a first call imports and compiles
is not on the way. Of the option those functions count that get its value, or what holds it.

On 1 December 2026: from a CSV to the summary 909 functions in 122 modules, an option to its use 60
functions and two objects, a plugin's model to its fit 73, a chromosome to its fitness 30. Of the
first, features, tables and coordinates have 190, their files 68, the choice among methods and its
blunders 162, fits, models and their accuracy 165, adjustment and priors 101, the run 89, the text
56.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import termsel
from termsel.cli.main import cli

PACKAGE = str(Path(termsel.__file__).parent)


@dataclass
class Walk:
    """What was walked through: functions by module, in the order of their first call."""

    title: str
    functions: dict[tuple[str, str], None] = field(default_factory=dict)

    @property
    def modules(self) -> set[str]:
        """Modules that the functions are of."""
        return {module for module, _ in self.functions}

    @property
    def rooms(self) -> set[str]:
        """Rooms that the modules are in."""
        return {module.partition("/")[0] for module in self.modules}

    def see(self, frame: FrameType, event: str, _argument: Any) -> None:
        """Take note of a call, as `sys.setprofile` has it."""
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE) \
                and not code.co_name.startswith("<"):
            module = code.co_filename[len(PACKAGE) + 1:].removesuffix(".py")
            self.functions.setdefault((module, code.co_qualname))


@dataclass
class Carrying(Walk):
    """A walk along one value: the functions that get it, and the kinds of objects that hold it."""

    value: int = 4242
    holders: dict[str, None] = field(default_factory=dict)

    def see(self, frame: FrameType, event: str, argument: Any) -> None:
        """Take note of a call whose arguments hold the value."""
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE):
            names = code.co_varnames[:code.co_argcount + code.co_kwonlyargcount + 2]
            if any(self.holds(frame.f_locals[name]) for name in names if name in frame.f_locals):
                super().see(frame, event, argument)

    def holds(self, held: Any, depth: int = 4) -> bool:
        """Return whether something is the value, or text, a collection or an object with it."""
        if isinstance(held, int | str):
            return str(held) == str(self.value) or (
                isinstance(held, str) and held.endswith(f"={self.value}"))
        if depth == 0:
            return False
        if isinstance(held, Mapping):
            return any(self.holds(item, depth - 1) for item in held.values())
        if isinstance(held, list | tuple):
            return any(self.holds(item, depth - 1) for item in held[:100])
        if type(held).__module__.startswith("termsel.") and not isinstance(held, type):
            # What an object only reaches through another object it does not hold itself.
            own = [value for value in vars(held).values()
                   if not type(value).__module__.startswith("termsel.")] \
                if hasattr(held, "__dict__") else []
            if any(self.holds(item, depth - 1) for item in own):
                self.holders.setdefault(type(held).__name__)
                return True
            return any(self.holds(item, depth - 1) for item in vars(held).values()) \
                if hasattr(held, "__dict__") else False
        return False


class Reached(Exception):
    """The option is where it is used."""


@contextmanager
def walking(walk: Walk) -> Iterator[None]:
    """Count the functions that are called inside of it."""
    sys.setprofile(walk.see)
    try:
        yield
    finally:
        sys.setprofile(None)


def twice(title: str, work: Callable[[], object]) -> Walk:
    """Return the walk of some work once it has been done before."""
    work()
    walk = Walk(title)
    with walking(walk):
        work()
    return walk


class Demo(termsel.RationalModel):
    """Direct linear transformation, as a plugin's author writes it."""

    name = "dlt-of-walks"

    def blocks(self, ground: np.ndarray) -> termsel.Blocks:
        """Return the columns of numerators and of the denominator."""
        numerator = np.column_stack([np.ones(len(ground)), ground])
        return termsel.Blocks(line=numerator, sample=numerator, shared_denominator=ground)


def table_to_summary(folder: Path) -> Walk:
    """From a table of 74 points to the text that `termsel run` shows."""
    points = termsel.simulate_scene("ikonos-hamedan").points
    rows = [f"{name},{line!r},{sample!r},{x!r},{y!r},{z!r}" for name, (line, sample), (x, y, z)
            in zip(points.ids, points.image.tolist(), points.ground.tolist(), strict=True)]
    table = folder / "points.csv"
    table.write_text("\n".join(["id,line,sample,x,y,z", *rows]) + "\n", encoding="utf-8")
    return twice("CSV to summary", lambda: termsel.run(
        features=table, crs="EPSG:4979").summary())


def option_to_use(folder: Path) -> Carrying:
    """From an option on the command line to the solver that takes its value."""
    from termsel.selection.solvers.genetic.ga import GeneticAlgorithm

    walk = Carrying("option to its use")
    generations = GeneticAlgorithm.generations

    def reached(self: GeneticAlgorithm, *_arguments: object) -> Any:
        assert self.options["population"] == walk.value
        raise Reached

    def command() -> None:
        arguments = ["run", "--problem", "poly-terms", "--solver", "ga", "--quiet",
                     "--set", f"population={walk.value}", "--out", str(folder / "result")]
        with suppress(Reached):
            cli.main(arguments, standalone_mode=False)

    GeneticAlgorithm.generations = reached  # type: ignore[method-assign, assignment]
    try:
        command()
        with walking(walk):
            command()
    finally:
        GeneticAlgorithm.generations = generations  # type: ignore[method-assign]
    return walk


def model_to_fit() -> Walk:
    """From a model of a plugin to its fit."""
    scene = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    return twice("plugin's model to its fit", lambda: termsel.fit(scene, Demo).coefficients)


def chromosome_to_fitness() -> Walk:
    """From genes to what they are worth."""
    problem = termsel.prepare("rfm-terms").problem
    genes = problem.genome.random(np.random.default_rng(1), 20)
    return twice("chromosome to fitness", lambda: problem.evaluate(genes))


def walks() -> list[Walk]:
    """Return all walks."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        return [table_to_summary(folder), option_to_use(folder), model_to_fit(),
                chromosome_to_fitness()]


def main() -> None:
    """Print the walks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--names", metavar="TEXT", help="list the functions of walks with the text")
    options = parser.parse_args()
    for walk in walks():
        held = f"; held by {', '.join(walk.holders)}" if isinstance(walk, Carrying) else ""
        print(f"{walk.title}: {len(walk.functions)} functions, {len(walk.modules)} modules, "
              f"{len(walk.rooms)} rooms{held}")
        if options.names and options.names in walk.title:
            for module, function in walk.functions:
                print(f"    {module}: {function}")


if __name__ == "__main__":
    main()
