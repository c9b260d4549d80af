"""The numbers of some sixty commands, to compare a program with itself before and after a change.

``python tests/recorded.py FOLDER`` runs each command below with a fixed seed and keeps what it
writes: ``python tests/recorded.py FOLDER --against OLD`` then compares every number with those of
an older folder, to 1e-9 of the larger, and names the keys that differ. It ends with code 1 if any
does, or if a command fails. Texts that differ, and keys that only one of both results has, are
counted; a change of wording or of the schema makes them. ``--only TEXT`` takes the commands that
hold the text. Times, versions and paths are not compared.

Each command has a folder to itself, as a run looks for results of the same check points next to its
own. ``--commands`` runs the ``termsel`` of another environment, so that an older program, which may
have no such file, is recorded by this one.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

QUICK = "--generations 3 --set population=20"

SEARCHES = [
    f"run --problem {problem} --dataset ikonos-hamedan --solver {solver} --seed 3 {QUICK}"
    for problem, solver in (
        ("rfm-terms", "ga"), ("rfm-terms", "ica"), ("rfm-terms", "pso"), ("rfm-terms", "nsga2"),
        ("rfm-terms", "ga-correlation"), ("rfm-terms", "ga-transgenic"),
        ("poly-terms", "ga"), ("poly-terms", "ica"), ("poly-terms", "pso"),
        ("rfm-terms-lines", "ga"), ("owdis-points", "ga"), ("owdis-lines", "ga"),
        ("owdis-points-terms", "ga"), ("owdis-lines-terms", "ga"), ("owdis-points", "nsga2"))]

OTHERS = """
run --problem rfm-terms --solver aco --seed 3 --generations 3
run --problem rfm-terms --solver random --seed 3 --evaluations 200
run --problem rfm-terms --solver stepwise
run --problem rfm-terms --solver nested-regression
run --problem rfm-terms --solver lasso
run --problem rfm-terms --solver ridge
run --problem rfm-terms --solver all-terms
run --problem rfm-terms --solver swap --seed 3 --evaluations 500
run --problem rfm-terms --solver deap --seed 3 --generations 3
run --problem rfm-terms --solver pymoo --seed 3 --generations 3
run --problem poly-terms --solver exact --set degree=2
run --problem poly-terms --solver exact --set degree=3
run --problem poly-terms --criterion press --solver ga --seed 3 --generations 3
run --problem poly-terms --criterion kfold --solver ga --seed 3 --generations 3
run --problem poly-terms --criterion ebic --solver exact --set degree=2
run --problem owdis-points --solver ga-steady --seed 3 --generations 3
run --problem valadan-zoej-2002 --seed 3 --generations 2
run --problem zakaryaie-2015 --seed 3 --generations 2
run --problem konugurthi-2016 --seed 3 --generations 2
run --problem yavari-2018 --seed 3 --generations 2
run --problem akhoundi-2020 --seed 3 --generations 2
run --problem owdis-lines
run --dataset ikonos-hamedan
run --dataset ikonos-hamedan --model affine --solver all-terms
run --dataset ikonos-hamedan --model poly2d --set degree=2 --solver all-terms
run --dataset ikonos-hamedan --model poly3d --set degree=2 --solver all-terms
run --dataset ikonos-hamedan --model rfm --set order=1 --set denominators=shared --solver all-terms
run --dataset ikonos-hamedan --model dlt3d --solver all-terms
run --dataset ikonos-hamedan --model dlt2d --solver all-terms
run --dataset ikonos-hamedan --model projective2d --solver all-terms
run --dataset ikonos-hamedan --model tps --solver all-terms
run --dataset ikonos-hamedan --model field3d --solver all-terms
run --dataset ikonos-hamedan --model helmert2d --solver all-terms
run --dataset ikonos-hamedan --model multiquadric --solver all-terms
run --dataset ikonos-hamedan --model hybrid-1 --solver all-terms
run --dataset ikonos-hamedan --model hybrid-3 --solver all-terms
run --points files/gcps.csv
run --points files/gcps.csv --model affine --solver all-terms
run --points files/gcps.csv --problem rfm-terms --seed 2 --generations 3
run --points files/gcps.csv --rpc files/vendor.RPB
run --points files/gcps.csv --model rpc-shift --rpc files/vendor.RPB --solver all-terms
run --points files/noheader.txt --columns id=1,x=2,y=3,z=4,sample=5,line=6 --crs EPSG:4979
run --points files/scene.points
run --points files/gcps.csv --lines files/lines.csv
run --areas files/areas.csv --crs EPSG:4979
run --lines files/lines.csv --crs EPSG:4979
"""


def numbers(value: Any, key: str = "$") -> Iterator[tuple[str, Any]]:
    """Yield every number and text of a result by its key, in the order of the file."""
    if isinstance(value, dict):
        for name, part in value.items():
            if name not in LEFT_OUT:
                yield from numbers(part, f"{key}.{name}")
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from numbers(part, f"{key}[{index}]")
    else:
        yield key, value


LEFT_OUT = {"seconds", "versions", "source", "checksums", "plugins", "history"}
"""Keys that differ between two runs or two machines."""

RECORD = Path("result") / "result.json"
"""The record of a command, in its folder."""


@dataclass
class Comparison:
    """The keys in which two results differ, with what each has."""

    numbers: list[str] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    only_in_one: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        counts = {"numbers differ": len(self.numbers), "texts differ": len(self.texts),
                  "keys are in one alone": len(self.only_in_one)}
        return ", ".join(f"{count} {words}" for words, count in counts.items() if count) \
            or "the same"


def compare(new: Any, old: Any) -> Comparison:
    """Return how two results differ: numbers by more than 1e-9 of the larger."""
    now = dict(numbers(new))
    before = dict(numbers(old))
    comparison = Comparison(only_in_one=sorted(before.keys() ^ now.keys()))
    for key in sorted(before.keys() & now.keys()):
        values = (before[key], now[key])
        if values[0] == values[1]:
            continue
        words = f"{key}: {values[0]!r} before, {values[1]!r} now"
        # A figure that is missing in one of both is a difference of numbers, too.
        if any(isinstance(value, str) for value in values):
            comparison.texts.append(words)
        elif None in values or not math.isclose(*values, rel_tol=1e-9, abs_tol=1e-12):
            comparison.numbers.append(words)
    return comparison


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the commands, and compare them with an older folder where one is given."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="where results are kept")
    parser.add_argument("--against", type=Path, help="a folder of an older program")
    parser.add_argument("--only", default="", help="commands that hold this text")
    parser.add_argument("--commands", type=Path, help="the folder of another termsel")
    options = parser.parse_args(arguments)
    termsel = "termsel" if options.commands is None else str(options.commands / "termsel")
    options.folder.mkdir(parents=True, exist_ok=True)
    if not (options.folder / "files").exists():
        subprocess.run([termsel, "example", "files"], cwd=options.folder, check=True)
    commands = [*SEARCHES, *OTHERS.strip().splitlines()]
    differing = 0
    for number, command in enumerate(commands):
        if options.only not in command:
            continue
        name = re.sub(r"\W+", "-", command)[:120]
        out = options.folder / f"{number:02}-{name}"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        done = subprocess.run([termsel, *shlex.split(command), "--out", f"{out.name}/result"],
                              cwd=options.folder, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{name}: code {done.returncode}: {done.stderr.strip()[-200:]}", flush=True)
            differing += 1
        elif options.against:
            old = options.against / out.name / RECORD
            if not old.exists():
                print(f"{name}: not in {options.against}", flush=True)
                continue
            comparison = compare(json.loads((out / RECORD).read_text(encoding="utf-8")),
                                 json.loads(old.read_text(encoding="utf-8")))
            differing += bool(comparison.numbers)
            print(f"{name}: {comparison}", flush=True)
            for line in comparison.numbers[:5]:
                print(f"    {line}")
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
