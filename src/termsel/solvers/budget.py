"""The budget of a search."""

from __future__ import annotations

import time
from dataclasses import dataclass

from termsel.solvers.base import Generation
from termsel.solvers.ledger import Ledger


@dataclass(frozen=True)
class Budget:
    generations: int | None
    evaluations: int | None
    seconds: float | None
    start: float

    def share(self, generation: Generation, ledger: Ledger) -> float | None:
        """Return the spent fraction of the budget that is spent first."""
        elapsed = time.perf_counter() - self.start
        shares = [value / limit for value, limit in (
            (generation.index, self.generations), (ledger.count, self.evaluations),
            (elapsed, self.seconds)) if limit is not None]
        known = generation.details.get("share")
        return min(1.0, max(shares)) if shares else known

    def spent(self, generation: Generation, ledger: Ledger) -> bool:
        """Return True if no further generation may begin."""
        return ((self.generations is not None and generation.index >= self.generations)
                or (self.evaluations is not None and ledger.count >= self.evaluations)
                or (self.seconds is not None
                    and time.perf_counter() - self.start >= self.seconds))
