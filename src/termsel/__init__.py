"""Select sensor-model terms and ground control features for georeferencing images.

The public names stand in ``__init__.pyi``. They are imported when first used, so that importing
termsel, and answering ``termsel --help``, costs next to nothing.
"""

from typing import Any

import lazy_loader

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name; one that has moved to a package, with a warning until 0.4."""
    if name not in ("from_deap", "from_pymoo", "to_deap"):
        return _public(name)
    import warnings

    from termsel.errors import requires

    with requires(f"termsel.{name} requires", "termsel_optimisers", "./plugins/termsel-optimisers"):
        import termsel_optimisers
    warnings.warn(f"termsel.{name} is called termsel_optimisers.{name}; the old name goes away in "
                  "0.4", DeprecationWarning, stacklevel=2)
    return getattr(termsel_optimisers, name)
