"""How charts and pages of termsel look."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
