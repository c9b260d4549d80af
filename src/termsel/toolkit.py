"""What packages build on next to the names of `termsel`: parts of commands, files and studies.

The names stand in ``toolkit.pyi``, and are imported when first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub("termsel", __file__)
