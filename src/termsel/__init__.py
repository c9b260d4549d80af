"""Select sensor-model terms and ground control features for georeferencing images.

The public names stand in ``__init__.pyi``. They are imported when first used, so that importing
termsel, and answering ``termsel --help``, costs next to nothing.
"""

import sys

# `python -m termsel`, `python -m termsel.check`: Python puts the current folder first on the path,
# and a file there that is called json.py would run in place of Python's own.
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and sys.path and any(
        flag.endswith("m") and module.partition(".")[0] == "termsel"
        for flag, module in zip(sys.orig_argv, sys.orig_argv[1:], strict=False)):
    del sys.path[0]

import lazy_loader

_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Return a public name, imported when it is first used.

    Raises AttributeError, with what may be meant, for a name that termsel does not have.
    """
    if name in __all__ or name.startswith("_"):
        return _imported(name)
    from termsel.core.arguments import missing_name_message

    # With a name of its own, Python adds no guess to that of the message.
    raise AttributeError(missing_name_message(__name__, name, __all__), name=name)
