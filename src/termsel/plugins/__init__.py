"""Plugins: what they provide (`hookspecs`), and the registry of everything provided.

The built-in models, problems, solvers and so on are registered through the same hooks, in
`builtin`. This package imports none of its modules: `termsel --help` reads its `commands` alone.
"""
