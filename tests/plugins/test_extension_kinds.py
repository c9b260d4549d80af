"""A package that brings genes, moves, a split, a section of the report and a measure of its own."""

from __future__ import annotations

import csv
import sys
from importlib.metadata import distributions
from importlib.util import find_spec
from textwrap import dedent

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.plugins.registry import Registry, registry
from termsel.testing import check

CODE = """
    import numpy as np
    import termsel
    from termsel import (CustomSegment, Evaluation, Genome, Measure, Note, Problem, Recipe,
                         ReportSection, Selection, Split, TableBlock, hookimpl)

    class Fenced(CustomSegment):
        '''Whole numbers from 0 to 60 that are multiples of seven.'''
        @property
        def limits(self):
            return 0, 56
        def repaired(self, genes):
            return 7 * np.clip(np.rint(genes / 7), 0, 8).astype(int)
        def steps(self, genes):
            around = np.repeat(genes[None], 2 * self.size, axis=0)
            for i in range(self.size):
                around[2 * i, i] = min(genes[i] + 7, 56)
                around[2 * i + 1, i] = max(genes[i] - 7, 0)
            yield around

    moved = []

    class Fences(Problem):
        '''Numbers near 21, and all of them alike.'''
        objectives = ("distance",)
        def __init__(self, inputs):
            self.inputs = inputs
            self.genome = Genome([Fenced("fences", ("a", "b", "c"))])
        def evaluate(self, genes):
            return Evaluation(np.abs(genes - 21).sum(axis=1, keepdims=True).astype(float)
                              + 50.0 * (genes != genes[:, :1]).any(axis=1, keepdims=True),
                              np.zeros(len(genes)))
        def decode(self, genes):
            values = dict(zip("abc", map(int, genes)))
            return Selection(self.inputs.model.terms, self.inputs.control.ids, values)
        def moves(self, genes):
            moved.append(1)
            yield np.repeat(np.arange(0, 57, 7)[:, None], 3, axis=1)

    @hookimpl
    def termsel_problems():
        return [Recipe("fences", "Multiples of seven.", Fences, model="affine",
                       dataset="ikonos-hamedan")]

    def by_campaign(ids, ground, shares, rng):
        return ["control" if i % 2 else "independent" if i % 4 else "check"
                for i in range(len(ids))]

    @hookimpl
    def termsel_splits():
        return [Split("campaign", "Every second point is control.", by_campaign)]

    def blocks(result):
        yield f"Terms <b>{len(result.selection.terms)}</b> in a <script>.";
        yield TableBlock("Own table", ("term",), [(name,) for name in result.selection.terms])
        yield Note("Own note.")

    @hookimpl
    def termsel_sections():
        return [ReportSection("own", "Terms again.", "What does the package say?", blocks),
                ReportSection("broken", "Fails.", "What fails?", lambda result: 1 / 0)]

    def largest(result):
        return float(len(result.selection.terms))

    @hookimpl
    def termsel_measures():
        return [Measure("terms_again", "Number of terms.", largest),
                Measure("no_number", "Fails.", lambda result: "many")]
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    place = tmp_path / "site"
    (place / "own_kinds-1.0.dist-info").mkdir(parents=True)
    (place / "own_kinds.py").write_text(dedent(CODE))
    info = place / "own_kinds-1.0.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-kinds\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[termsel]\nown = own_kinds\n")
    monkeypatch.syspath_prepend(place)
    monkeypatch.setenv("PYTHONPATH", str(place))
    # Statistics of a study are those of a package.
    monkeypatch.setenv("TERMSEL_PLUGINS", ",".join(
        ["own-kinds", *["termsel-studies"] * bool(find_spec("termsel_studies"))]))
    monkeypatch.chdir(tmp_path)
    registry.cache_clear()
    yield lambda: sys.modules["own_kinds"]
    registry.cache_clear()
    sys.modules.pop("own_kinds", None)


@pytest.mark.parametrize("solver", ["ga", "pso", "swap", "random"])
def test_solvers_search_genes_of_a_package(package, solver):
    result = termsel.run("fences", solver=solver, evaluations=900, seed=2)
    assert all(value % 7 == 0 for value in result.selection.parameters.values())
    if solver in ("ga", "swap"):
        assert result.selection.parameters == {"a": 21, "b": 21, "c": 21}


def test_the_local_refinement_takes_the_moves_of_a_problem(package):
    # Three at once: single steps lead from one local optimum to the next.
    result = termsel.run("fences", solver="random", evaluations=60, seed=1,
                         options={"polish": True})
    assert result.selection.parameters == {"a": 21, "b": 21, "c": 21}
    assert package().moved


def test_a_move_that_is_not_valid_names_the_package(package):
    termsel.get("problems", "fences")
    package().Fences.moves = type("Other", (package().Fences,), {
        "moves": lambda _self, _genes: iter([np.full((1, 3), 5)])}).moves
    with pytest.raises(termsel.TermselError, match=r"own-kinds 1.0: moves\(\) yields genes"):
        termsel.run("fences", solver="swap", evaluations=60)


def test_solvers_of_bits_refuse_genes_of_a_package(package):
    with pytest.raises(termsel.TermselError, match="those of 'fences' are Fenced"):
        termsel.run("fences", solver="exact")


def test_a_split_of_a_package_assigns_the_roles(package):
    result = termsel.run("poly-terms", evaluations=60,
                         options={"roles": "campaign", "model.degree": 1})
    n = len(result.features.points)
    assert result.data.counts.control == n // 2
    assert "campaign" in str(result.options)
    with pytest.raises(termsel.TermselError, match="unknown split 'campain'"):
        termsel.prepare("poly-terms", options={"roles": "campain"})


def test_a_split_that_returns_no_roles_is_named(package):
    termsel.get("splits", "campaign")
    wrong = termsel.Split("wrong", "No roles.", package().blocks)
    with pytest.raises(termsel.TermselError, match=r"own-kinds 1\.0"):
        wrong.roles(("a",), np.zeros((1, 3)), np.ones(3) / 3, np.random.default_rng(1))


@pytest.mark.slow
def test_sections_are_in_text_and_page_and_failures_are_contained(package, tmp_path):
    result = termsel.run("poly-terms", evaluations=60, options={"model.degree": 1}, out="out")
    text = (tmp_path / "out" / "summary.txt").read_text()
    assert "What does the package say?" in text
    assert "Own table" in text
    assert "Note: Own note." in text
    assert "Not shown:" in text
    assert "ZeroDivisionError" in text
    result.report("page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Own table" in page
    assert "&lt;b&gt;6&lt;/b&gt; in a &lt;script&gt;" in page
    assert "ZeroDivisionError" in page


def test_a_run_asks_nothing_of_a_package_that_names_no_hook(tmp_path, package):
    place = tmp_path / "site"
    (place / "nameless.py").write_text("import termsel\n")
    (place / "nameless-1.0.dist-info").mkdir()
    (place / "nameless-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: nameless\nVersion: 1.0\n")
    (place / "nameless-1.0.dist-info" / "entry_points.txt").write_text(
        "[termsel]\nnameless = nameless\n")
    point = next(one for found in distributions(path=[str(place)]) for one in found.entry_points
                 if one.name == "nameless")
    names = Registry([point])
    names.entries("sections")
    names.observers()
    assert "nameless" not in sys.modules
    names.entries("models")  # asked for by name: it may make its hooks
    assert "nameless" in sys.modules


def test_measures_are_columns_of_a_study(package, tmp_path):
    pytest.importorskip("termsel_studies")
    asked = ["compare", "--problem", "poly-terms", "--solver", "random,swap", "--seeds", "1",
             "--evaluations", "60", "--set", "model.degree=1",
             "--measures", "terms_again,no_number", "--measure", "terms_again", "--out", "s"]
    answer = CliRunner().invoke(cli, asked)
    assert answer.exit_code == 0, answer.output
    assert "Compared by terms_again; lower is better." in answer.output
    rows = list(csv.DictReader((tmp_path / "s" / "study.csv").open()))
    assert [row["terms_again"] for row in rows] == [f"{int(row['n_terms'])}.0" for row in rows]
    assert all(row["no_number"] == "" and "failed in compute()" in row["notes"] for row in rows)
    again = termsel.read_study("s")
    assert again.rows[0]["terms_again"] == float(rows[0]["terms_again"])


@pytest.mark.parametrize(("name", "what"), [
    ("terms_agai", "unknown measure 'terms_agai'"),
    ("check", "unknown measure 'check'")])
def test_a_measure_that_does_not_exist_is_refused(package, name, what):
    with pytest.raises(termsel.TermselError, match=what):
        termsel.compare(problems=["poly-terms"], solvers=["random"], measures=[name])


def test_a_measure_hidden_by_a_column_is_refused(package):
    termsel.register(termsel.Measure("n_terms", "Hidden.", len))
    with pytest.raises(termsel.TermselError, match="every study has a column 'n_terms'"):
        termsel.compare(problems=["poly-terms"], solvers=["random"], measures=["n_terms"])


def test_all_of_it_is_listed_and_described(package):
    for kind, name in (("splits", "campaign"), ("sections", "own"), ("measures", "terms_again")):
        assert name in CliRunner().invoke(cli, ["list", kind]).output
        assert "own-kinds" in CliRunner().invoke(cli, ["describe", name]).output
    assert "splits" in CliRunner().invoke(cli, ["plugins"]).output


def test_conformance(package):
    check(termsel.get("problems", "fences"))
    check(termsel.get("splits", "campaign"))
    check(termsel.get("sections", "own"))
    check(termsel.get("measures", "terms_again"))
    for kind, name in (("sections", "broken"), ("measures", "no_number")):
        with pytest.raises(AssertionError, match="was raised"):
            check(termsel.get(kind, name))
