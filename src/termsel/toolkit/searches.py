"""Problems, genomes and solvers beyond what `termsel` names."""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
