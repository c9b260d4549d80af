"""Certificates: what is true is proven, what was changed is refused."""

from __future__ import annotations

import copy
import itertools
import json
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("termsel_bench", reason="termsel-bench is not installed: "
                    "pip install -e plugins/termsel-bench")

import termsel
from termsel import SubsetSystem, check
from termsel_bench import certificate


def _system(seed: int, k: int = 6, *, rational: bool = True) -> SubsetSystem:
    rng = np.random.default_rng(seed)
    design, extra = rng.uniform(-1, 1, (10, k)), rng.uniform(-1, 1, (7, k))
    truth = rng.normal(size=k) * (rng.random(k) < 0.6)
    below, extra_below = np.zeros((10, k)), np.zeros((7, k))
    if rational:
        below[:, k // 2:], extra_below[:, k // 2:] = (
            0.3 * rng.uniform(-1, 1, (n, k - k // 2)) for n in (10, 7))
    return SubsetSystem(
        design, (design @ truth + 0.1 * rng.normal(size=10))[:, None], extra,
        (extra @ truth + 0.1 * rng.normal(size=7))[:, None],
        below if rational else None, extra_below if rational else None, margin=0.1)


def _scores(system: SubsetSystem, room: int) -> dict[tuple[int, ...], float]:
    """Return the score of each feasible selection, by an adjustment of each."""
    assert system.check_design is not None
    assert system.check_target is not None
    scores = {}
    for size in range(room + 1):
        for chosen in map(list, itertools.combinations(range(system.design.shape[1]), size)):
            x = np.linalg.lstsq(system.design[:, chosen], system.target[:, 0])[0]
            errors = system.check_target[:, 0] - system.check_design[:, chosen] @ x
            if system.check_denominator is not None:
                below = 1.0 + system.check_denominator[:, chosen] @ x
                if below.min() < system.margin:
                    continue
                errors = errors / below
            scores[tuple(chosen)] = float(errors @ errors)
    return scores


def _axis(system: SubsetSystem, chosen: tuple[int, ...], room: int) -> dict[str, Any]:
    names = [f"t{j}" for j in range(system.design.shape[1])]
    return certificate.axis_of("line", names, system, chosen, room, 1.0)


def _checked(content: dict[str, Any], folder: Path) -> tuple[list[str], int]:
    """Check a content, with a checksum that fits it."""
    body = {key: value for key, value in content.items() if key != "sha256"}
    body = json.loads(json.dumps(body))
    file = folder / "certificate.json"
    file.write_text(json.dumps({**body, "sha256": check.checksum(body)}))
    return check.check(file)


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    system = _system(3)
    scores = _scores(system, 5)
    content = certificate.content_of([_axis(system, min(scores, key=scores.__getitem__), 5)])
    return content, tmp_path_factory.mktemp("proof")


@pytest.mark.parametrize("rational", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_the_best_of_all_selections_is_proven_and_no_other(
        tmp_path: Path, seed: int, rational: bool) -> None:
    system = _system(seed, rational=rational)
    scores = _scores(system, 5)
    ranked = sorted(scores, key=scores.__getitem__)
    lines, open_ = _checked(certificate.content_of([_axis(system, ranked[0], 5)]), tmp_path)
    assert open_ == 0
    assert f"{(scores[ranked[0]] / 7)**0.5:.6f} px" in lines[-1]
    assert f"{sum(1 for n in range(6) for _ in itertools.combinations(range(6), n))} " in lines[-3]
    second = certificate.content_of([_axis(system, ranked[1], 5)])
    with pytest.raises(check.Refused, match=r"line, step \d+: a selection"):
        _checked(second, tmp_path)


def test_a_tree_of_few_steps_says_what_is_open(proof: tuple[dict[str, Any], Path]) -> None:
    content, folder = proof
    axis = {key: value for key, value in content["axes"][0].items() if key != "nodes"}
    lines, open_ = _checked(certificate.content_of([axis], max_steps=3), folder)
    assert open_ > 0
    assert not any(line.startswith("no selection") for line in lines)


def test_a_certificate_with_open_selections_is_written_and_says_so(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(certificate, "MAX_NODES", 4)
    file = tmp_path / "certificate.json"
    termsel.run("poly-terms", solver="exact", options={"certificate": True, "degree": 2},
                out=tmp_path)
    open_ = check.check(file)[1]
    assert open_ > 0
    assert f"{open_:,} selections are left open" in caplog.text


def test_a_path_decides_its_selections_alone(proof: tuple[dict[str, Any], Path]) -> None:
    content, folder = proof
    axis = content["axes"][0]
    nodes = certificate.tree_of(axis, 1000, [(1, True), (4, False)])
    _, open_ = _checked({**content, "axes": [{**axis, "nodes": nodes}]}, folder)
    decided = sum(1 for n in range(5) for _ in itertools.combinations(range(4), n))
    assert open_ == 63 - decided  # of up to 5 of 6 terms


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_changed_file_is_refused(proof: tuple[dict[str, Any], Path],
                                   data: st.DataObject) -> None:
    content, folder = proof
    text = json.dumps(content)
    at = data.draw(st.integers(0, len(text) - 1))
    other = data.draw(st.sampled_from("0123456789.,[]{}e-ax"))
    file = folder / "changed.json"
    file.write_text(text[:at] + other + text[at + 1:])
    if other == text[at]:
        assert check.check(file)[1] == 0
    else:
        try:
            read = json.loads(file.read_text())
        except ValueError:
            read = None
        if read != content:  # "1.0" for "1.00" says the same
            with pytest.raises(check.Refused):
                check.check(file)


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_no_forged_tree_proves_a_limit_that_a_selection_is_below(
        proof: tuple[dict[str, Any], Path], data: st.DataObject) -> None:
    content, folder = copy.deepcopy(proof[0]), proof[1]
    axis = content["axes"][0]
    scores = _scores(_system(3), 5)
    worse = sorted(scores, key=scores.__getitem__)[data.draw(st.integers(1, 8))]
    axis["selection"], axis["limit"] = list(worse), scores[worse] * (1 - 1e-9)
    what = data.draw(st.sampled_from(["none", "drop", "close", "pole", "more", "numbers"]))
    at = data.draw(st.integers(0, len(axis["nodes"]) - 1))
    if what == "drop":
        del axis["nodes"][at]
    elif what == "close":
        axis["nodes"][at:] = [["closed", data.draw(st.floats(-1e9, 1e9))]]
    elif what == "pole":
        axis["nodes"][at:] = [["closed", data.draw(st.floats(-1e9, 1e9)),
                               data.draw(st.integers(0, 6))]]
    elif what == "more":
        axis["nodes"].insert(at, ["limits", data.draw(st.floats(-1e9, 1e9))])
    elif what == "numbers":
        for node in axis["nodes"]:
            if node[0] == "closed":
                node[1] = [data.draw(st.floats(-1e6, 1e6)) for _ in node[1]]
    with pytest.raises(check.Refused):
        _checked(content, folder)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_what_any_multipliers_prove_of_a_node_is_true_of_all_its_selections(
        data: st.DataObject) -> None:
    """The theorem, against an adjustment of each selection: with good multipliers and with bad.

    With few places rounding is no longer below all else.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "_PLACES", data.draw(st.sampled_from([10, 14, 20, 128])))
        _compare_a_node(data)


def _compare_a_node(data: st.DataObject) -> None:
    seed, rational = data.draw(st.integers(0, 30)), data.draw(st.booleans())
    system = _system(seed, rational=rational)
    scores = _scores(system, 5)
    ranked = sorted(scores, key=scores.__getitem__)
    axis = _axis(system, ranked[data.draw(st.integers(0, len(ranked) - 1))], 5)
    checker = check.Axis({**axis, "nodes": []})
    node, inside = checker.root(), list(scores)
    for j in data.draw(st.permutations(range(6)))[:data.draw(st.integers(0, 4))]:
        uses = data.draw(st.booleans())
        node = checker.halves(node, j)[uses]
        inside = [chosen for chosen in inside if (j in chosen) == uses]
    below = [chosen for chosen in inside if scores[chosen] < axis["limit"]]
    for _ in range(3):
        size = 10.0 ** data.draw(st.integers(-2, 1))
        alphas = [size * data.draw(st.floats(-0.2, 2.0)) for _ in node.rest]
        for k in [None, *range(7 * rational)]:
            assert not (below and checker.is_closed(node, alphas, k))
        try:
            node = checker.limited(node, alphas)
        except check.Refused:
            continue
        for chosen in map(list, below):
            x = np.linalg.lstsq(system.design[:, chosen], system.target[:, 0])[0]
            assert system.check_denominator is not None
            values = 1.0 + system.check_denominator[:, chosen] @ x
            reached = np.append(values, 1.0) / values.sum()
            assert (reached <= np.array([u / check.UPPER for u in node.upper]) + 1e-12).all()


def test_limits_close_what_no_single_bound_does() -> None:
    system = _system(3)
    scores = _scores(system, 5)
    checker = check.Axis({**_axis(system, min(scores, key=scores.__getitem__), 5), "nodes": []})
    node, steps = checker.root(), 0
    for j in range(3):
        node = checker.halves(node, j)[0]
    assert not checker.is_closed(node, 1.0)
    while not checker.is_closed(node, 1.0):
        before, node, steps = node.upper, checker.limited(node, 1.0), steps + 1
        assert all(new <= old for new, old in zip(node.upper, before, strict=True))
        assert steps < 20


@pytest.mark.parametrize(("change", "said"), [
    (lambda axis: axis.update(limit=axis["limit"] * 0.99), "too far below"),
    (lambda axis: axis.update(limit=axis["limit"] * 1.01), "does not have the score"),
    (lambda axis: axis.update(limit=float("nan")), "not finite"),
    (lambda axis: axis.update(margin=-1.0), "limit, margin"),
    (lambda axis: axis.update(selection=[0, 0]), "selection"),
    (lambda axis: axis.update(room=99), "terms"),
    (lambda axis: axis["control"][0].pop(), "one value for each term"),
    (lambda axis: axis.update(nodes=[]), "ends before step 1"),
    (lambda axis: axis["nodes"].append(["one"]), "goes on"),
    (lambda axis: axis.update(nodes=[["guess"]]), "no step 'guess'"),
    (lambda axis: axis.update(nodes=[["one"]]), "terms are open"),
    (lambda axis: axis.update(nodes=[["split", 7]]), "not open"),
    (lambda axis: axis.update(nodes=[["closed", 1.0, 7]]), "a denominator"),
    (lambda axis: axis.update(nodes=[["closed", [1.0]]]), "argument"),
    (lambda axis: axis.update(nodes=[["closed", float("inf")]]), "not finite"),
    (lambda axis: axis.update(nodes=[["limits", -1e9]]), "limits have no proof"),
    (lambda axis: axis["denominators"][0].__setitem__(-1, 1.0), "denominators"),
    (lambda axis: axis.pop("nodes"), "form termsel-certificate-2"),
    (lambda axis: axis.update(pixels=0.0), "pixels"),
    (lambda axis: axis.update(axis="line: 1 px\nno selection"), "neither line nor sample"),
])
def test_what_does_not_hold_is_named(proof: tuple[dict[str, Any], Path], change: Any,
                                     said: str) -> None:
    content = copy.deepcopy(proof[0])
    change(content["axes"][0])
    with pytest.raises(check.Refused, match=said):
        _checked(content, proof[1])


def _copies(axis: dict[str, Any], **changes: Any) -> list[dict[str, Any]]:
    return [axis, {**axis, "axis": "sample", **changes}]


def test_scores_of_axes_of_one_image_are_added(proof: tuple[dict[str, Any], Path]) -> None:
    content, folder = proof
    axis = content["axes"][0]
    alone = _checked(content, folder)[0]
    both = _checked({**content, "axes": _copies(axis)}, folder)[0]
    value = (axis["limit"] / 7) ** 0.5
    assert alone[-1] == (f"no selection has an RMSE there below {value:.6f} px in line, of this "
                         "axis alone")
    assert alone[-2] == f"RMSE at the selection points: {value:.6f} px in line, of this axis alone"
    assert both[-1] == f"no selection has an RMSE there below {2**0.5 * value:.6f} px"
    assert both[-2] == f"RMSE at the selection points: {2**0.5 * value:.6f} px"


def test_axes_of_other_points_or_pixels_are_not_added(proof: tuple[dict[str, Any], Path]) -> None:
    """An axis of no terms, with one small error, proves what is said of it."""
    content, folder = proof
    axis = content["axes"][0]
    most = {"terms": ["1"], "room": 0, "selection": [], "forced": [], "control": [[1.0, 0.0]],
            "denominators": [], "limit": 1e-6 * (1 - 1e-9), "nodes": [["one"]]}
    small = {**axis, **most, "errors": [[0.0, 1e-3]]}
    assert _checked({**content, "axes": [small]}, folder)[1] == 0
    for axes in (_copies(axis, **{**most, "errors": small["errors"]}), _copies(axis, pixels=0.5)):
        with pytest.raises(check.Refused, match="same number of selection points and pixels"):
            _checked({**content, "axes": axes}, folder)
    for axes in ([], [axis, axis]):
        with pytest.raises(check.Refused, match="twice, or none"):
            _checked({**content, "axes": axes}, folder)


def test_the_score_is_at_most_what_the_page_says(tmp_path: Path) -> None:
    """Limits next to the least that the claim L (1 + 1e-8) allows, of a score that is exact."""
    error = 1.25 + 2.0**-20
    score = Fraction(error) ** 2
    axis = {"axis": "line", "terms": ["1"], "room": 0, "selection": [], "forced": [],
            "control": [[1.0, 0.0]], "errors": [[0.0, error]], "denominators": [], "margin": 0.1,
            "pixels": 1.0, "nodes": [["one"]]}
    limit = float(score / (1 + Fraction(1, 10**8)))
    for near in (math.nextafter(limit, 0.0), limit, math.nextafter(limit, 2.0)):
        content = {"schema": check.CERTIFICATE_SCHEMA, "axes": [{**axis, "limit": near}]}
        if score <= Fraction(near) * (1 + Fraction(1, 10**8)):
            assert _checked(content, tmp_path)[1] == 0
        else:
            with pytest.raises(check.Refused, match="too far below"):
                _checked(content, tmp_path)


def test_a_certificate_of_the_first_form_is_to_be_written_again(
        proof: tuple[dict[str, Any], Path]) -> None:
    with pytest.raises(check.Refused, match=r"termsel-certificate-1.*write it again"):
        _checked({**proof[0], "schema": "termsel-certificate-1"}, proof[1])


def test_exact_writes_a_certificate_that_a_process_without_the_solver_checks(
        tmp_path: Path) -> None:
    file = tmp_path / "certificate.json"
    options = {"certificate": "yes", "degree": 3, "force_off": "line.num:X3"}
    result = termsel.run("poly-terms", solver="exact", options=options, out=tmp_path)
    assert result.rmse["check"] is not None
    code = ("import sys; from termsel.check import main; status = main(sys.argv[1:]); "
            "assert 'numpy' not in sys.modules and 'termsel.selection.solvers' not in sys.modules; "
            "raise SystemExit(status)")
    done = subprocess.run([sys.executable, "-c", code, str(file)], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    assert f"below {result.rmse['check'].total:.6f} px" in done.stdout
    # The one file, by a Python that finds no package.
    single = subprocess.run([sys.executable, "-I", "-S", str(check.__file__), str(file)],
                            capture_output=True, text=True, check=False)
    assert (single.returncode, single.stdout) == (0, done.stdout), single.stderr
    file.write_text(file.read_text().replace("closed", "opened", 1))
    done = subprocess.run([sys.executable, "-m", "termsel.check", str(file)], capture_output=True,
                          text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == (f"{file}: refused: the checksum is not that of the content; "
                           "write it again\n")


@pytest.mark.parametrize(("options", "criterion", "said"), [
    ({"certificate": "proof.json"}, "check-rmse", "Accepted: true | false"),
    ({"certificate": True}, "press", "no certificate of this problem"),
    ({"certificate": True, "mask": "shared"}, "check-rmse", "mask='per-axis'"),
])
def test_what_cannot_be_certified_is_refused_at_once(
        tmp_path: Path, options: dict[str, Any], criterion: str, said: str) -> None:
    with pytest.raises(termsel.TermselError) as caught:
        termsel.run("poly-terms", solver="exact", criterion=criterion, options=options,
                    out=tmp_path)
    assert said in f"{caught.value} {caught.value.hint}"
    assert not (tmp_path / "certificate.json").exists()


def test_a_certificate_needs_the_folder_of_a_result() -> None:
    with pytest.raises(termsel.TermselError, match="file of the folder of a result") as caught:
        termsel.run("poly-terms", solver="exact", options={"certificate": True})
    assert "out=DIR" in str(caught.value.hint)
    with pytest.raises(termsel.TermselError, match="keep no certificates"):
        termsel.compare(problems=["poly-terms"], solvers=["exact"], options={"certificate": True})


def test_a_result_without_a_certificate_leaves_none_of_an_earlier_one(tmp_path: Path) -> None:
    options = {"certificate": True, "degree": 2}
    termsel.run("poly-terms", solver="exact", options=options, out=tmp_path)
    assert (tmp_path / "certificate.json").exists()
    termsel.run("poly-terms", solver="exact", options={"degree": 2}, out=tmp_path, overwrite=True)
    assert not (tmp_path / "certificate.json").exists()


def test_the_whole_theorem_is_printed_before_what_is_proved(
        proof: tuple[dict[str, Any], Path]) -> None:
    """A forged `forced` makes a theorem that is true, but smaller: it is printed."""
    content = copy.deepcopy(proof[0])
    axis = content["axes"][0]
    smaller = {**axis, "forced": sorted(axis["selection"])[:2], "room": 4}
    smaller = {key: value for key, value in smaller.items() if key != "nodes"}
    best = min((chosen for chosen in itertools.combinations(range(6), 4)
                if set(smaller["forced"]) <= set(chosen)), key=lambda chosen: _scores(
                    _system(3), 4).get(chosen, math.inf))
    made = _axis(_system(3), best, 4) | {"forced": smaller["forced"]}
    lines, _ = _checked({**certificate.content_of([made]), "data": "a" * 64}, proof[1])
    text = "\n".join(lines)
    start = lines.index("What is proved of it:")
    forced = ", ".join(f"t{j}" for j in smaller["forced"])
    for said in ("SHA-256 " + "a" * 64, "10 equations", "7 selection points",
                 f"forced into every selection, 2: {forced}", "room: at most 4 terms",
                 "margin: denominators at the selection points are at least 0.1",
                 f"limit of the sum of squared errors: {made['limit']:.12g}"):
        assert said in text
        assert said not in "\n".join(lines[start:])
    assert any("enumerated or excluded" in line for line in lines[start:])


@pytest.mark.parametrize(("change", "said"), [
    ({"data": "the data of\x1b[31m another"}, "checksum of data"),
    ({"axes": [{"terms": ["t0\nforced: none", *"abcde"]}]}, "printable")])
def test_no_text_of_a_certificate_reaches_the_terminal(
        proof: tuple[dict[str, Any], Path], change: dict[str, Any], said: str) -> None:
    content = copy.deepcopy(proof[0])
    for axis in change.pop("axes", []):
        content["axes"][0].update(axis)
    with pytest.raises(check.Refused, match=said):
        _checked({**content, **change}, proof[1])


def test_values_that_no_certificate_can_hold_are_refused_before_the_search(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place in the middle of all: its fifth power has too many binary places."""
    rng = np.random.default_rng(0)
    ground = np.vstack([[[0.0, 0.0], [1e3, 1e3], [500.00000001, 500.000000001]],
                        rng.uniform(0.0, 1e3, (40, 2))])
    rows = [f"P{i},{'check' if i % 3 == 2 else 'control'},{2 * y + 1e-4 * x**2},{2 * x},{x},{y},"
            for i, (x, y) in enumerate(ground.tolist())]
    file = tmp_path / "points.csv"
    file.write_text("\n".join(["id,role,line,sample,x,y,z", *rows]))
    monkeypatch.setattr("termsel.selection.solvers.proofs.exact.prove",
                        lambda *_: pytest.fail("searched"))
    with pytest.raises(termsel.TermselError, match="too many binary places") as caught:
        termsel.run("poly-terms", features=file, crs="local", solver="exact",
                    options={"degree": 5, "certificate": True}, out=tmp_path / "out")
    assert "lower degree" in str(caught.value.hint)


@pytest.mark.slow_cases("TemporaryDirectory-error2", "tree_of-error1")
@pytest.mark.parametrize(("name", "error"), [
    ("check", check.Refused("axis line, step 3: it does not hold")),
    ("tree_of", ValueError("a number is not finite")),
    ("TemporaryDirectory", OSError("the disk is full"))])
def test_a_search_is_not_lost_where_its_certificate_is(
        name: str, error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture) -> None:
    def failing(*_: Any) -> None:
        raise error

    monkeypatch.setattr(certificate, name, failing)
    result = termsel.run("poly-terms", solver="exact",
                         options={"certificate": True, "degree": 2}, out=tmp_path)
    assert result.certificate is not None
    assert result.certificate.optimal
    assert not (tmp_path / "certificate.json").exists()
    assert (tmp_path / "result.json").exists()
    assert f"no certificate is written: {error}" in caplog.text


@pytest.mark.slow
def test_an_rfm_of_second_order_is_certified(tmp_path: Path) -> None:
    termsel.run("rfm-terms", solver="exact",
                options={"order": 2, "max_terms": 6, "certificate": True}, out=tmp_path)
    lines, open_ = check.check(tmp_path / "certificate.json")
    assert open_ == 0
    assert lines[-1].startswith("no selection")
