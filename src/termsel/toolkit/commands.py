"""Parts of commands: options that they share, progress, output."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
