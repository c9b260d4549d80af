"""Run the benchmarks: ``python -m benchmarks [name ...]``; all of them without a name.

``python -m benchmarks all`` makes the evidence pages instead (see `benchmarks.pages`).
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

# One core for all, or the threads of the alternatives would be compared.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))


def duration(seconds: float | None) -> str:
    """Return a time to three digits in a suitable unit."""
    if seconds is None:
        return ""
    unit, name = next((one for one in UNITS if seconds >= one[0]), UNITS[-1])
    return f"{seconds / unit:.3g} {name}"


def main(names: list[str]) -> None:
    """Run the modules named, such as "kernels", and print one table."""
    if names[:1] == ["all"]:
        importlib.import_module("benchmarks.pages").main(names[1:])
        return
    here = Path(__file__).parent
    found = sorted(path.stem for path in here.glob("bench_*.py"))
    wanted = [f"bench_{name}" for name in names] or found
    unknown = sorted(set(wanted) - set(found))
    if unknown:
        sys.exit(f"no benchmark {unknown[0].removeprefix('bench_')!r}; there are: "
                 + ", ".join(name.removeprefix("bench_") for name in found))
    table = Table("benchmark", "what", title="Times on one core, least of several", expand=False)
    for heading in ("ours", "alternative", "its time", "ratio", "disagreement"):
        table.add_column(heading, justify="left" if heading == "alternative" else "right")
    errors = Console(stderr=True)
    with errors.status("") as status:
        for module in wanted:
            for row in importlib.import_module(f"benchmarks.{module}").rows():
                what, ours, alternative, theirs, ratio, gap = row
                status.update(what)
                table.add_row(module.removeprefix("bench_"), what, duration(ours), alternative,
                              duration(theirs), "" if ratio is None else f"{ratio:.1f}",
                              "" if gap is None else f"{gap:.0e}")
            table.add_section()
    # A file or pipe has no width of its own; the table is then as wide as it needs.
    Console(width=None if sys.stdout.isatty() else 160).print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
