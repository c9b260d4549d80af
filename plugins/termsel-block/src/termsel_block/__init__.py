"""Blocks: several images adjusted together by control and the ties between them, as a plugin.

References
----------
Grodecki, Dial 2003: Block adjustment of high-resolution satellite images described by rational
polynomials. PE&RS 69(1), 59-68.
Triggs, McLauchlan, Hartley, Fitzgibbon 2000: Bundle adjustment, a modern synthesis. LNCS 1883.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel_block.block import Block, BlockImage, Ties
    from termsel_block.files.block_file import read_block
    from termsel_block.files.folders import write_block
    from termsel_block.files.places import write_places
    from termsel_block.joint import BlockResult, adjust

# What is not needed for `termsel run` is not imported for it.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "joint": ["BlockResult", "adjust"], "block": ["Block", "BlockImage", "Ties"],
    "files.block_file": ["read_block"], "files.folders": ["write_block"],
    "files.places": ["write_places"]})

__all__ = ["Block", "BlockImage", "BlockResult", "Ties", "adjust", "read_block", "write_block",
           "write_places"]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the commands."""
    from termsel_block.commands import add_commands

    add_commands(cli)
