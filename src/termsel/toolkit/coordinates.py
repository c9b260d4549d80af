"""Coordinates: what a CRS is, and points of one in another, in metres and from the Earth's centre."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
