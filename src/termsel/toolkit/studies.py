"""Cells of studies, their journal, their tables and pages."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
