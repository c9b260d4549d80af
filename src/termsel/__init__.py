"""Select sensor-model terms and ground control features for georeferencing images.

The public names stand in ``__init__.pyi``. They are imported when first used, so that importing
termsel, and answering ``termsel --help``, costs next to nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
