"""What is asked of a run, and how it is observed and ends."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
