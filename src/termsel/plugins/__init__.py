"""Plugins: what they provide (`hookspecs`), and the registry of everything provided (`manager`).

The built-in models, problems, solvers and so on are registered through the same hooks, in
`builtin`.
"""

from termsel.plugins.hookspecs import hookimpl

__all__ = ["hookimpl"]
