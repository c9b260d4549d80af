"""Rules of the project that no general tool knows: ``python -m tests.lint``."""
