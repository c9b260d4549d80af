"""Plugins whose faults would give wrong results in silence."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.isolation.faults import PluginFault
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import Selection
from termsel.selection.solvers.base import Generation, Solver

AFFINE = """
    import numpy as np
    from termsel import Blocks, RationalModel, hookimpl

    class Affine(RationalModel):
        '''An affine model of another kind.'''
        name = "affine"
        def blocks(self, ground):
            one = np.column_stack([np.ones(len(ground)), {columns}])
            return Blocks(line=one, sample=one)

    @hookimpl
    def termsel_models():
        return [Affine]
"""

CLAIMING = """
    from termsel import Generation, Solver, hookimpl

    class Claiming(Solver):
        '''Claims that the first random selection is the best.'''
        name = "claiming"
        def generations(self, problem, rng):
            genes = problem.genome.random(rng, 20)
            yield Generation(0, genes, problem.evaluate(genes), {{"certificate": {certificate}}})

    @hookimpl
    def termsel_solvers():
        return [Claiming]
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that puts a package into a folder of PYTHONPATH."""
    # `python -m termsel` takes no module from the folder where it is started.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def package(distribution: str, code: str, version: str = "1.0") -> None:
        (tmp_path / f"{distribution}.py").write_text(dedent(code))
        info = tmp_path / f"{distribution}-1.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(f"[termsel]\n{distribution} = {distribution}\n")

    return package


def _termsel(tmp_path: Path, *args: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "termsel", *args], cwd=tmp_path, text=True,
                          capture_output=True, check=False, timeout=300)


RUN = ("run", "--problem", "rfm-terms", "--model", "demo:affine", "--solver", "all-terms",
       "--out", "r")


@pytest.mark.slow
def test_a_result_is_read_with_the_plugin_that_made_it(install: Callable[..., None],
                                                       tmp_path: Path) -> None:
    install("demo", AFFINE.format(columns="ground[:, 0] * ground[:, 1], ground[:, :2]"))
    assert _termsel(tmp_path, *RUN).returncode == 0
    (tmp_path / "at.csv").write_text("id,X,Y,Z\na,0,0,1000\n")
    # The name of the record is the plugin's model, not the built-in one that has it alone.
    read = _termsel(tmp_path, "project", "r", "--points", "at.csv")
    assert read.returncode == 0, read.stderr
    # Another version of the same model: the coefficients mean something else.
    install("demo", AFFINE.format(columns="ground[:, :2], ground[:, 0] * ground[:, 1]"), "1.1")
    refused = _termsel(tmp_path, "project", "r", "--points", "at.csv")
    assert refused.returncode == 2
    assert "the model is not the one of the run" in refused.stderr
    assert "demo:affine of version 1.0" in refused.stderr
    for file in tmp_path.glob("demo*/*"):
        file.unlink()
    refused = _termsel(tmp_path, "project", "r", "--points", "at.csv")
    assert refused.returncode == 2
    assert "package demo, which is not installed" in refused.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("certificate", "code", "said"), [
    ('{"optimal": True, "subsets": 20, "of": 20, "space": "all"}', 0, "claiming:claiming claims"),
    ('{"optimal": True}', 2, "the certificate of solver 'claiming:claiming' lacks something")])
def test_a_proof_of_a_plugin_is_its_claim(install: Callable[..., None], certificate: str,
                                          code: int, said: str, tmp_path: Path) -> None:
    install("claiming", CLAIMING.format(certificate=certificate))
    done = _termsel(tmp_path, "run", "--problem", "rfm-terms", "--solver", "claiming", "--verbose")
    assert done.returncode == code
    assert said in " ".join((done.stdout + done.stderr).split())
    assert "Proven" not in done.stdout


class Broadcast(CheckRmse):
    """One figure for all models."""

    name = "broadcast"

    def score(self, fits: termsel.Fits) -> np.ndarray:
        return super().score(fits)[:1]


def test_one_figure_for_all_models_is_refused() -> None:
    task = termsel.prepare("rfm-terms", solver="ga")
    said = r"criterion 'broadcast' .*: score\(\) returned an array of shape \(1,\)"
    with pytest.raises(TermselError, match=said):
        termsel.search(task.problem.judged_by(Broadcast()), task.solver)


class Strange(Solver):
    """Asks for evaluations of what it is given."""

    name = "strange"
    genes = np.zeros((1, 1))

    def generations(self, problem: termsel.Problem, rng: np.random.Generator,
                    ) -> Iterator[Generation]:
        yield Generation(0, self.genes, problem.evaluate(self.genes))


@pytest.mark.parametrize("change", [
    lambda genes: genes.astype(int) * 3, lambda genes: genes.astype(float),
    lambda genes: genes[:, :-1], lambda genes: genes[0], lambda genes: genes.tolist()])
def test_anything_but_bits_of_the_genome_is_refused(
        change: Callable[[np.ndarray], np.ndarray]) -> None:
    problem = termsel.prepare("rfm-terms", solver="ga").problem
    solver = Strange()
    solver.genes = change(problem.genome.random(np.random.default_rng(1), 5))
    with pytest.raises(TermselError, match=r"expected bool and \(n, 78\)"):
        termsel.search(problem, solver)


@pytest.mark.parametrize(("selection", "said"), [
    (Selection(("line.nom:X",), ()), r"names an unknown term 'line\.nom:X'"),
    (Selection((), ("nobody",)), "names an unknown control feature 'nobody'")])
def test_a_name_that_is_not_there_is_refused_with_the_line_of_the_problem(
        selection: Selection, said: str) -> None:
    class Naming(termsel.SelectionProblem):
        """Decodes what there is not."""

        def decode(self, genes: np.ndarray) -> Selection:
            return selection

    recipe = termsel.Recipe("naming", "Wrong names.", lambda inputs: Naming(
        inputs, terms=True, features=False), model="affine", dataset="ikonos-hamedan")
    with pytest.raises(PluginFault, match=rf"problem Naming of the module tests: decode\(\) {said}"
                       ) as caught:
        termsel.run(recipe, solver="random", generations=1)
    line = Path(__file__).read_text().splitlines()[caught.value.line - 1]
    assert (Path(caught.value.file).name, line.strip()) == (
        Path(__file__).name, "def decode(self, genes: np.ndarray) -> Selection:")


def test_objectives_are_names_and_not_letters() -> None:
    task = termsel.prepare("rfm-terms", solver="ga")
    task.problem.objectives = "check"
    with pytest.raises(TermselError, match="are 'check', not a tuple of names"):
        termsel.search(task.problem, task.solver)


TALKING = """
    import os, threading
    from termsel import Criterion, hookimpl
    from termsel.selection.criteria import CheckRmse

    print("imported")
    {thread}

    class Talking(CheckRmse):
        '''Prints what it is asked.'''
        name = "talking"
        def score(self, fits):
            print("asked")
            return super().score(fits)

    @hookimpl
    def termsel_criteria():
        return [Talking]
    @hookimpl
    def termsel_commands(cli):
        @cli.command("talk")
        def talk():
            '''Talk.'''
            print("of the command")
"""

BEAT = """def beat():
        while True: print("beat")
    threading.Thread(target=beat, daemon=True).start()"""


@pytest.mark.slow
@pytest.mark.parametrize("thread", ["", BEAT], ids=["calls", "a thread"])
def test_stdout_has_the_result_alone(install: Callable[..., None], thread: str, tmp_path: Path,
                                     ) -> None:
    install("talking", TALKING.format(thread=thread))
    done = _termsel(tmp_path, "run", "--problem", "poly-terms", "--criterion", "talking",
                    "--generations", "1", "--set", "population=10", "--json")
    assert json.loads(done.stdout)["criterion"] == "talking"
    assert "imported" in done.stderr
    assert "asked" in done.stderr  # anywhere: lines of two threads run into each other


@pytest.mark.slow
def test_a_command_of_a_plugin_has_stdout(install: Callable[..., None], tmp_path: Path) -> None:
    install("talking", TALKING.format(thread=""))
    done = _termsel(tmp_path, "talk")
    assert done.stdout == "of the command\n"
    assert done.stderr == "imported\n"


STAYING = """
    import threading, time
    from termsel import hookimpl
    from termsel.selection.criteria import CheckRmse

    def stay():
        time.sleep(1000)

    {imported}

    class Staying(CheckRmse):
        '''Leaves a thread.'''
        name = "staying"
        def score(self, fits):
            {called}
            return super().score(fits)

    @hookimpl
    def termsel_criteria():
        return [Staying]
"""


@pytest.mark.slow
@pytest.mark.parametrize("place", ["imported", "called"])
def test_a_thread_that_never_ends_does_not_keep_termsel(
        install: Callable[..., None], place: str, tmp_path: Path) -> None:
    install("staying", STAYING.format(**{
        **dict.fromkeys(("imported", "called"), "pass"),
        place: "threading.Thread(target=stay).start()"}))
    done = _termsel(tmp_path, "run", "--problem", "poly-terms", "--criterion", "staying",
                    "--solver", "all-terms", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["criterion"] == "staying"
    said = "a thread of staying 1.0 does not end; termsel ends without it" in done.stderr
    assert said == (place == "called")  # what an import starts ends with the program
