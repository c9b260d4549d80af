"""Parts of conformance suites, for kinds of things of a package's own."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
