"""What a CRS is, and points in another one, in metres, or from the centre of the Earth."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
