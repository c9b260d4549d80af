"""What was found of features, for runs on the same data that pass it on to each other.

Another solver, seed or criterion changes nothing of what the features alone say.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit, Undetermined
from termsel.fitting.method import Method

MAX_ANSWERS = 16
"""How much is kept, the last used: verdicts and errors, a few numbers for each feature."""

MAX_FITS = 64
"""How many fits are kept."""

MAX_KEPT_FEATURES = 1000
"""Most features whose fits are kept: more take memory."""

_T = TypeVar("_T")

_NO_PICKLE = (pickle.PicklingError, TypeError, AttributeError, ValueError, RecursionError,
              NotImplementedError)
"""What pickling raises of what cannot be."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What was found of the last features by some methods.

    Parameters
    ----------
    max_answers : int
        How many answers are kept, the last used.

    Examples
    --------
    >>> import termsel
    >>> memory = termsel.Memory(max_answers=4)
    >>> data = termsel.FitData.of(termsel.simulate_scene("spot-isfahan"))
    >>> auto = termsel.Auto(memory=memory)
    >>> [auto.fit(data).method.name for _ in range(2)]  # the second time it is looked up
    ['regularised-cubic', 'regularised-cubic']
    """

    max_answers: int = MAX_ANSWERS
    _answers: dict[Hashable, tuple[Any]] = field(default_factory=dict, init=False, repr=False)
    _fits: dict[tuple[Method, Hashable], Fit | Undetermined] = field(
        default_factory=dict, init=False, repr=False)
    _latest: dict[str, tuple[FitData, bytes | None]] = field(
        default_factory=dict, init=False, repr=False)

    def recall(self, question: Hashable, data: FitData, find: Callable[[], _T],
               faults: Callable[[], int] = lambda: 0) -> _T:
        """Return the answer that is kept for equal features, or the one that `find` gives.

        `question` says what is asked, and of which methods. An answer of `find` is kept, unless the
        number of `faults` has risen meanwhile: without the fault the answer may be another.
        """
        checksum = self._checksum(data)
        if checksum is None:
            return find()
        key = question, checksum
        # Taken out, to be put to the end again: the last used are kept. Each of these steps is one
        # that no other thread can come between.
        answer = self._answers.pop(key, None)
        if answer is None:
            faults_before = faults()
            answer = (find(),)
            if faults() > faults_before:
                return answer[0]
        self._answers[key] = answer
        while len(self._answers) > self.max_answers:
            self._answers.pop(list(self._answers)[0], None)  # noqa: RUF015 (threads may add)
        return answer[0]

    def fit(self, method: Method, data: FitData) -> Fit:
        """Return the fit of a method that is termsel's own, and keep it for equal features.

        Raises
        ------
        Undetermined
            If the features do not determine it.
        """
        if len(data) > MAX_KEPT_FEATURES:
            return method.fit(data)
        # By the features, whatever run asks: of a change that is taken back the fit is known.
        key = method, self._checksum(data) or data
        fitted = self._fits.get(key)
        if fitted is None:
            try:
                fitted = replace(method.fit(data), method=method)
            except Undetermined as error:
                fitted = error
            while len(self._fits) >= MAX_FITS:
                self._fits.pop(list(self._fits)[0], None)  # noqa: RUF015 (threads may add)
            self._fits[key] = fitted
        if isinstance(fitted, Undetermined):
            raise fitted.with_traceback(None)
        return fitted

    def _checksum(self, data: FitData) -> bytes | None:
        """Return a checksum that equal features share; None if they cannot be pickled."""
        latest = self._latest.get("data")
        # Each method asks about the same features.
        if latest is not None and latest[0] is data:
            return latest[1]
        try:
            checksum = hashlib.sha256(pickle.dumps(data)).digest()  # features may be many
        except _NO_PICKLE:
            checksum = None
        self._latest["data"] = data, checksum
        return checksum

    def __reduce__(self) -> tuple[type[Memory], tuple[int]]:
        # Another process finds its own answers.
        return Memory, (self.max_answers,)
