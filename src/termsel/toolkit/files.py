"""Reading and writing of files, rasters and maps."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
