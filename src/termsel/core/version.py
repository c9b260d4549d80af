"""The version of termsel, and of the hooks that it offers to plugins."""

__version__ = "0.3.0.dev0"

_MAJOR, _MINOR = map(int, __version__.split(".")[:2])

# Before 1.0 a minor version may change the hooks, so that the two change together.
PLUGIN_API = f"{_MAJOR}.{_MINOR}"
"""The version of the hooks: packages that were written for it work with every 0.3.x."""


def plugin_bound() -> str:
    """Return the versions of termsel that a plugin of this one works with: ``>=0.3,<0.4``."""
    # Before the release of 0.3.0 it begins with the development version, which >=0.3 would leave
    # out.
    development = __version__ if "dev" in __version__ else PLUGIN_API
    return f">={development},<{_MAJOR}.{_MINOR + 1}"
