"""What more than one package builds on next to the names of `termsel`.

The names stand in the stubs next to each module, and are imported when first used. Coordinates
and charts are in modules of their own, and so is by topic what one package alone builds on.
"""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
