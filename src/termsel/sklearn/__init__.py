"""Deprecated name of `termsel_sklearn`, the package termsel-sklearn; it goes away in 0.4."""

from __future__ import annotations

import warnings

from termsel.errors import requires

with requires("termsel.sklearn requires", "termsel_sklearn", "./plugins/termsel-sklearn"):
    from termsel_sklearn import (
        EXPECTED_FAILED_CHECKS,
        SensorModelRegressor,
        TermSelector,
        spatial_blocks,
    )

__all__ = ["EXPECTED_FAILED_CHECKS", "SensorModelRegressor", "TermSelector", "spatial_blocks"]

warnings.warn("termsel.sklearn is called termsel_sklearn; the old name goes away in 0.4",
              DeprecationWarning, stacklevel=2)
