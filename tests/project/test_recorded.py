"""Results of an earlier program are compared number by number (`python tests/recorded.py`)."""

from __future__ import annotations

from tests.recorded import compare


def test_numbers_texts_and_keys_are_counted_apart() -> None:
    old = {"rmse": 1.0, "note": "as it was", "terms": [1.0, 2.0], "limit": None, "gone": 1}
    new = {"rmse": 1.0 + 1e-12, "note": "otherwise", "terms": [1.0, 2.1], "limit": 3, "added": 1}
    comparison = compare(new, old)
    # A figure that was not known before is a difference of numbers.
    assert [line.partition(":")[0] for line in comparison.numbers] == ["$.limit", "$.terms[1]"]
    assert len(comparison.texts) == 1
    assert comparison.only_in_one == ["$.added", "$.gone"]
    assert str(compare(old, old)) == "the same"
