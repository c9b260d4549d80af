"""Files in and out: one module a family of formats.

`base` holds what every format shares, `atomic` writes a file whole or not at all.
"""
