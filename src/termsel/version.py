"""The version of termsel."""

__version__ = "0.2.0"
