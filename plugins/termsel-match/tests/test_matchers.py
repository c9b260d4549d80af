"""Matchers: the built-in ones, those of other packages, and other contrast."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

import termsel
from termsel import TermselError
from termsel.testing import checks
from termsel.toolkit import registry
from termsel.toolkit.suites import KINDS
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.phase import Phase
from termsel_match.matchers.sift import Sift
from termsel_match.matchers.structure import Structure
from termsel_match.points.candidates import match_points as match


class Learned(Matcher):
    """A stand-in for a learned matcher: a small random network as its descriptor."""

    name = "learned-demo"
    declared_options = (termsel.Option("weights", "", "File with the weights of the network."),)

    def match(self, first: Window, second: Window, search: float) -> Matches:
        """Return corners whose descriptors are each other's nearest."""
        places, vectors = zip(*(self._described(window) for window in (first, second)),
                              strict=True)
        if not len(places[0]) or not len(places[1]):
            return Matches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))
        likeness = vectors[0] @ vectors[1].T
        to = likeness.argmax(axis=1)
        own = np.flatnonzero(likeness.argmax(axis=0)[to] == np.arange(len(to)))
        score = likeness[own, to[own]]
        order = np.argsort(-score, kind="stable")
        return Matches(places[0][own][order], places[1][to[own]][order], score[order])

    def _described(self, window: Window) -> tuple[Any, Any]:
        layer = np.random.default_rng(0).standard_normal((64, 225))
        pixels = cv2.GaussianBlur(window.pixels, (0, 0), 1)
        inner = cv2.erode(window.known.astype(np.uint8), np.ones((17, 17)), borderValue=0)
        corners = cv2.goodFeaturesToTrack(pixels, 300, 0.01, 5, mask=inner)
        if corners is None:
            return np.empty((0, 2)), np.empty((0, 64))
        places = np.round(corners[:, 0, ::-1])
        patches = np.array([pixels[i - 7:i + 8, j - 7:j + 8].ravel()
                            for i, j in places.astype(int)])
        patches -= patches.mean(axis=1, keepdims=True)
        hidden = (patches / (patches.std(axis=1, keepdims=True) + 1e-9)) @ layer.T
        return places, hidden / np.linalg.norm(hidden, axis=1, keepdims=True)


CHECKS = {f"{thing.name}-{check.name}": check
          for thing in (Sift, Phase, Structure, Learned(weights="mine.pt"))
          for check in checks(thing)}


@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS)
def test_conforms(check: Any) -> None:
    check.run()


class Wrong(Matcher):
    """Returns what it should not."""

    name = "wrong-demo"
    answer: Matches

    def match(self, first: Window, second: Window, search: float) -> Matches:
        return self.answer


@pytest.mark.parametrize(("answer", "said"), [
    (None, "returned NoneType; expected Matches"),
    (Matches(np.zeros((3, 2)), np.zeros((2, 2)), np.zeros(3)), "second of shape (2, 2)"),
    (Matches(np.zeros(3), np.zeros(3), np.zeros(3)), "expected numbers of shape (3, 2)"),
    (Matches(np.full((1, 2), np.nan), np.zeros((1, 2)), np.zeros(1)), "not finite"),
    (Matches(np.zeros((1, 2)), np.zeros((1, 2)), np.full(1, 2.0)), "scores above 1"),
    (Matches(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1), np.zeros((1, 2))), "not above 0"),
], ids=["none", "counts", "shape", "nan", "score", "sigma"])
def test_a_matcher_that_is_wrong_is_named(place: Any, answer: Any, said: str) -> None:
    matcher = Wrong()
    matcher.answer = answer
    with pytest.raises(TermselError) as caught:
        match(place / "image.tif", place / "ortho.tif", matcher=matcher)
    assert "wrong-demo" in str(caught.value)
    assert said in str(caught.value)
    failed = [check.name for check in checks(matcher) if _fails(check)]
    assert "finds_a_shift" in failed


def _fails(check: Any) -> bool:
    try:
        check.run()
    except AssertionError:
        return True
    return False


@pytest.fixture
def known() -> Iterator[str]:
    entries = registry().entries("matchers")
    termsel.register(Learned)
    yield Learned.name
    provided = registry()._provided["matchers"]
    provided.entries[:] = entries


def _good(place: Any, found: Any) -> float:
    return float((place.errors(found.points, found.crs) < 1.5).mean())


def test_a_matcher_of_another_package_is_asked_by_its_name(place: Any, known: str) -> None:
    found = match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=60,
                  matcher=known)
    assert len(found.points) >= 20
    assert _good(place, found) > 0.7


def test_an_unknown_matcher_is_refused_with_the_known_ones(place: Any, says: Any) -> None:
    code, text = says("match-points", place / "image.tif", "--reference", place / "ortho.tif",
                      "--matcher", "sfit", "-o", place / "none.csv")
    assert code == 2
    assert "Did you mean 'sift'" in text


@pytest.mark.parametrize(("words", "said"), [
    (("--set", "a=1"), "Add --matcher NAME"),
    (("--matcher", "sift", "--set", "a"), "not KEY=VALUE"),
    (("--matcher", "sift", "--set", "a=1"), "'a'")])
def test_options_of_a_matcher_are_checked(place: Any, says: Any, words: Any, said: str) -> None:
    code, text = says("match-points", place / "image.tif", "--reference", place / "ortho.tif",
                      *words, "-o", place / "none.csv")
    assert code == 2
    assert said in text


@pytest.mark.slow
def test_an_inverted_image_is_matched_by_structure(
        place: Any, altered: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    image = altered("image.tif", lambda pixels: 2047 - pixels)
    with caplog.at_level("INFO", logger="termsel.match"):
        found = match(image, place / "ortho.tif", dem=place / "dem.tif", count=40)
    assert "the matcher sift finds" in caplog.text
    assert len(found.points) >= 30
    assert _good(place, found) > 0.8


@pytest.mark.slow
def test_structure_is_asked_where_sift_finds_few(
        place: Any, altered: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    def infrared(pixels: Any) -> Any:  # fields of another order of brightness
        bright = np.clip((pixels - 300.0) / 1300, 0, 1)
        return (500 + 400 * np.sin(9 * bright + 1)).astype(np.uint16)

    image = altered("image.tif", infrared)
    few = len(match(image, place / "ortho.tif", dem=place / "dem.tif", count=120,
                    matcher="sift").points)
    assert 8 <= few < 15
    with caplog.at_level("INFO", logger="termsel.match"):
        found = match(image, place / "ortho.tif", dem=place / "dem.tif", count=120)
    assert f"the matcher sift finds {few} candidates" in caplog.text
    assert len(found.points) > 3 * few
    assert _good(place, found) > 0.7


def test_phase_correlation_finds_candidates(place: Any) -> None:
    found = match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=60,
                  matcher="phase")
    assert len(found.points) >= 30
    assert _good(place, found) > 0.8


def test_the_registry_takes_from_the_class_what_a_matcher_is() -> None:
    kind = KINDS["matchers"]
    assert [kind.is_of(thing) for thing in (Sift, Sift(), Learned, termsel.Polynomial2D)] == [
        True, True, True, False]
    kind.require_returned(Learned)
    with pytest.raises(TypeError, match="class Polynomial2D, not a subclass of Matcher"):
        kind.require_returned(termsel.Polynomial2D)
