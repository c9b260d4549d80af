"""The commands of this package."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import click

from termsel import TermselError
from termsel.toolkit import free_name, remote_option

_PATH = click.Path(path_type=Path)


def add_commands(cli: click.Group) -> None:
    """Add the commands to a group."""
    cli.add_command(block)
    cli.add_command(block_example)
    cli.add_command(block_points)
    cli.add_command(block_select)


@click.command("block")
@click.argument("file", metavar="BLOCK.toml", type=_PATH)
@click.option("--out", "folder", metavar="DIR", type=_PATH,
              help="Folder for the block, and in it a folder for each image.")
@click.option("--overwrite", is_flag=True, help="Replace a block that is there.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON alone on stdout.")
@click.option("--verbose", is_flag=True, help="Print a row for each image and each blunder.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@remote_option
def block(file: Path, folder: Path | None, overwrite: bool, as_json: bool, verbose: bool,
          quiet: bool) -> None:
    """Adjust several images together, by their control and the ties between them.

    BLOCK.toml states the CRS, a table of ties id,image,line,sample, and the images. An image needs
    no control of its own. Each image gets a folder that project, export, rectify and report read.

    \b
    Examples:
      termsel block-example place
      termsel block place/block.toml --out place/adjusted
      termsel export place/adjusted/C --to rpb --output C.RPB
    """
    # Imported here, so that `termsel --help` does not wait for them.
    import msgspec

    from termsel.toolkit import share_bar, show_messages
    from termsel_block.files.block_file import read_block
    from termsel_block.files.folders import SUMMARY, require_free_folder, write_block
    from termsel_block.joint import adjust
    from termsel_block.shown.summary import first_screen, text_of

    show_messages()
    read = read_block(file)
    if folder is None:
        error = TermselError("--out is missing", hint="Give a folder for the block: --out DIR.")
        error.options["--out"] = free_name(file.parent / "adjusted")
        raise error
    # Minutes of adjustment are not begun for a folder that cannot be written.
    require_free_folder(folder, [image.name for image in read.images], overwrite=overwrite,
                        reads=[file, *read.files])
    with share_bar("adjusting", quiet) as progress:
        result = adjust(read, progress=progress)
    with share_bar("writing", quiet) as progress:
        record = write_block(result, folder, overwrite=overwrite, progress=progress)
    if as_json:
        click.echo(msgspec.json.encode(record))
    else:
        click.echo(text_of(record) if verbose else first_screen(record, folder.as_posix()),
                   nl=False)
    if as_json or verbose:
        click.echo(f"Written: {folder / SUMMARY} and the folders of {len(record.images)} images",
                   err=True)


@click.command("block-example")
@click.argument("folder", metavar="DIR", type=_PATH)
@click.option("--images", metavar="N", type=click.IntRange(2, 60), default=3, show_default=True,
              help="Number of images.")
@click.option("--check", metavar="N", type=click.IntRange(0), default=0,
              help="Points of each image that judge a selection.")
@click.option("--seed", type=int, default=1, show_default=True)
def block_example(folder: Path, images: int, check: int, seed: int) -> None:
    """Write a simulated block: images with RPCs, ties with blunders, six control points.

    DIR is a new folder. It gets block.toml, ties.csv, an RPC for each image, and tables of points.

    \b
    Example:
      termsel block-example place
    """
    from termsel_block.example import write_example

    write_example(folder, images, seed, check)
    click.echo(f"Next: termsel block {quote(str(folder / 'block.toml'))} "
               f"--out {quote(str(folder / 'adjusted'))}")


@click.command("block-points")
@click.argument("folder", metavar="DIR", type=_PATH)
@click.option("-o", "--output", metavar="FILE", type=_PATH, required=True,
              help="File to write: .gpkg, .las or .laz.")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
def block_points(folder: Path, output: Path, overwrite: bool) -> None:
    """Write the places of the ties of a block as a GeoPackage or a point cloud.

    Each place has its standard deviations to the east, to the north and up [m], and the number of
    images that see it. LAS needs laspy: pip install "termsel-block[las]".

    \b
    Example:
      termsel block-points place/adjusted -o places.gpkg
    """
    from termsel.toolkit import count_in_words
    from termsel_block.files.places import write_places

    n = write_places(folder, output, overwrite=overwrite)
    click.echo(f"Written: {output}, {count_in_words(n, 'place')}", err=True)


@click.command("block-select")
@click.argument("file", metavar="BLOCK.toml", type=_PATH)
@click.option("-o", "--output", metavar="FILE", type=_PATH, required=True,
              help="Table to write: kind,image,id of the control and the ties that are selected.")
@click.option("--solver", metavar="NAME", default="ga", show_default=True,
              help="Any solver of one objective: ga, ica, swap, or exact for few candidates.")
@click.option("--most", "most_features", metavar="N", type=click.IntRange(1),
              help="Most control features and ties together.")
@click.option("--candidates", metavar="N", type=click.IntRange(2), default=100, show_default=True,
              help="Candidates of ties: of more, as many that are well distributed.")
@click.option("--evaluations", metavar="N", type=click.IntRange(1), help="Budget of the search.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON alone on stdout.")
@remote_option
def block_select(file: Path, output: Path, solver: str, most_features: int | None, candidates: int,
                 evaluations: int | None, seed: int, overwrite: bool, as_json: bool) -> None:
    """Select which control and which ties of a block are enough (the problem owdis-block).

    Points of the images with the role check judge. Those with the role independent take no part,
    and show how accurate the block is with the selection.

    \b
    Example:
      termsel block-example place --check 10
      termsel block-select place/block.toml --most 20 -o enough.csv
    """
    import msgspec

    from termsel import require_replaceable
    from termsel.toolkit import write_text
    from termsel_block.files.block_file import read_block
    from termsel_block.selecting import select, table_of, text_of

    block = read_block(file)
    # Refused before the search, not after it.
    require_replaceable([output], reads=[file, *block.files], overwrite=overwrite,
                        written_as="CSV")
    selected = select(block, solver=solver, seed=seed, evaluations=evaluations, most=most_features,
                      tie_candidates=candidates)
    write_text(output, table_of(selected))
    click.echo(msgspec.json.encode(selected.record(solver, seed)) if as_json else text_of(selected),
               nl=as_json)
    click.echo(f"Written: {output}", err=True)
