"""The command `termsel example`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.messages import echo, say_written


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def example(folder: Path) -> None:
    """Write the files of the tutorial and of the how-to guides.

    DIR is a new folder. It gets images, control points and lines, heights, an RPC, matches and a
    batch of five images and one of four maps. All are simulated. README.txt says what each file is.

    \b
    Examples:
      termsel example files
    """
    from termsel.io.example import README, write_example

    write_example(folder)
    echo((folder / README).read_text(encoding="utf-8"), nl=False)
    say_written([folder])
