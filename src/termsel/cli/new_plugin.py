"""The command `termsel new-plugin`."""

from __future__ import annotations

import keyword
import re
import sys
from importlib.metadata import entry_points
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import click

from termsel.cli.messages import echo, say_written
from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.version import plugin_bound

NEW_KINDS = ("model", "solver", "problem", "criterion", "objective", "method", "dataset", "split",
         "section", "measure", "reader", "writer", "command")

_TESTS = "tests"
"""Folder of the tests of a new package."""

_DISTRIBUTION_NAME = re.compile(r"[A-Za-z](?:[A-Za-z0-9]|[-_.](?=[A-Za-z0-9]))*")

_USE = {
    "model": "Use it: `termsel run --problem rfm-terms --model {name}`",
    "solver": "Use it: `termsel run --problem rfm-terms --solver {name}`",
    "problem": "Use it: `termsel run --problem {name}`",
    "criterion": "Use it: `termsel run --problem rfm-terms --criterion {name}`",
    "objective": "Use it: `termsel run --problem owdis-points --solver nsga2 "
                 "--set objectives={name}`",
    "method": "Use it: `termsel run --points FILE --crs EPSG:n`; auto judges it with its own.",
    "dataset": "Use it: `termsel run --problem rfm-terms --dataset {name}`",
    "split": "Use it: `termsel run --problem rfm-terms --set roles={name}`",
    "section": "Use it: `termsel report DIR`, with the folder of a result; the section comes "
               "last.",
    "measure": "Use it: `termsel compare STUDY.toml --measures {name}`",
    "reader": "Use it: `termsel run --points FILE --crs EPSG:n`; termsel recognises the format.",
    "writer": "Use it: `termsel export DIR --to {name} --output FILE`",
    "command": "Use it: `termsel {name} DIR`, with the folder of a result",
}


@click.command("new-plugin")
@click.argument("name")
@click.option("--kind", required=True, metavar="KIND[,KIND]...",
              help="Kinds of things that it provides, separated by commas: "
                   f"{', '.join(NEW_KINDS)}.")
@click.option("--into", "parent", metavar="DIR", default=".", show_default=True,
              type=click.Path(path_type=Path), help="The folder in which the package is made.")
def new_plugin(name: str, kind: str, parent: Path) -> None:
    """Write a package with a working plugin, as a start for yours.

    NAME is that of the package, such as termsel-demo. The package installs without a network
    and any other package, and has tests.

    \b
    Examples:
      termsel new-plugin termsel-demo --kind model
      termsel new-plugin termsel-more --kind solver,criterion
      pip install ./termsel-demo
      termsel describe demo
    """
    texts = package_files(name, *(kind_name.strip() for kind_name in kind.split(",")))
    folder = parent / name
    if not parent.is_dir():
        raise TermselError("this is a file, expected a folder" if parent.exists() else
                           "this folder does not exist", file=parent,
                           hint="Make it first, or choose another: --into DIR.")
    # mkdir refuses an existing folder in one step: nothing can come in between.
    try:
        folder.mkdir()
        (folder / "tests").mkdir()
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8")
    except FileExistsError as error:
        raise TermselError("this folder exists, and nothing in it is replaced", file=folder,
                           hint="Choose another NAME, or another folder with --into.") from error
    except OSError as error:
        raise TermselError(f"cannot write: {error.strerror}", file=folder,
                           hint="Choose a folder that is writable: --into DIR.") from error
    say_written(folder / file for file in texts)
    # Without "./" pip would take the folder for the name of a package in an index.
    shown_folder = folder if folder.is_absolute() else f"./{folder}"
    echo(f"Install it: {Path(sys.executable).name} -m pip install {shown_folder}\n"
         f"Test it:    cd {folder}; {Path(sys.executable).name} -m unittest discover tests")


def package_files(name: str, *kinds: str) -> dict[str, str]:
    """Return the texts of the files of a new package, by their path in the package.

    Where there are several kinds, each has a module and a name of its own, such as demo-model.
    Raises TermselError for a kind that is blank, unknown or named twice, and for a name that is not
    free.
    """
    for kind in kinds:
        if not kind:
            raise TermselError(f"--kind {','.join(kinds)!r} leaves a kind blank",
                               hint="Name one kind, or several with a comma between: "
                                    f"--kind model,solver. Known: {', '.join(NEW_KINDS)}.")
        if kind not in NEW_KINDS:
            raise unknown_name_error("kind of plugin", kind, NEW_KINDS)
    if len(set(kinds)) < len(kinds):
        raise TermselError(f"--kind {','.join(kinds)} names a kind twice", hint="Name each once.")
    # As pip normalises names: termsel-demo has the module termsel_demo, and registers "demo".
    module = re.sub(r"[-_.]+", "_", name).lower()
    plugin_name = re.sub(r"[-_.]+", "-", name).lower().removeprefix("termsel-")
    has_one_kind = len(kinds) == 1
    modules = {kind: module if has_one_kind else f"{module}_{kind}" for kind in kinds}
    names = {kind: plugin_name if has_one_kind else f"{plugin_name}-{kind}" for kind in kinds}
    # All names are tried before any file is made.
    for kind in kinds:
        _require_free(name, module, plugin_name, kind, modules[kind], names[kind])
    titles = {kind: f"{_name_as_word(kind)} {names[kind]}" for kind in kinds}
    words = {
        "DISTRIBUTION": name, "BOUND": plugin_bound(),
        "TITLE": f"The {', the '.join(titles.values())}",
        "POINTS": "".join(f'{names[kind]} = "{modules[kind]}"\n' for kind in kinds),
        "DESCRIBED": "\n".join(f"termsel describe {names[kind]}" for kind in kinds),
        "USE": "\n\n".join(_USE[kind].format(name=names[kind]) for kind in kinds)}
    texts = {file: _fill_words(file, words)
             for file in ("pyproject.toml", "build_wheel.py", "README.md")}
    for kind in kinds:
        words_of_kind = {
            **words, "MODULE": modules[kind], "NAME": names[kind], "TITLE": f"The {titles[kind]}",
            "CLASS": "".join(syllable.capitalize() for syllable in names[kind].split("-"))}
        texts[f"{modules[kind]}.py"] = _fill_words(f"{kind}.py", words_of_kind)
        texts[f"{_TESTS}/test_{modules[kind]}.py"] = _fill_words(f"{kind}_test.py", words_of_kind)
    return texts


def _name_as_word(kind: str) -> str:
    """Return the kind of a thing as a noun."""
    return "data set" if kind == "dataset" else kind


def _fill_words(source: str, words: dict[str, str]) -> str:
    """Return a skeleton with its words, between @, replaced by those given."""
    text = (files("termsel.cli") / "skeletons" / f"{source}.txt").read_text(encoding="utf-8")
    return re.sub(r"@([A-Z]+)@", lambda mark: words[mark[1]], text)


def _require_free(name: str, package: str, bare: str, kind: str, module: str,
                  plugin_name: str) -> None:
    """Refuse a name of a package that cannot be one, or that something else has already.

    `name` is that of the distribution, `package` its import name, `bare` the name without
    "termsel-", `module` the module of this `kind`, and `plugin_name` what that would register.
    Raises TermselError with what to choose.
    """
    if not _DISTRIBUTION_NAME.fullmatch(name) or keyword.iskeyword(package) or not bare:
        # What remains of the name without forbidden characters is the nearest that can be.
        near = "-".join(re.findall(r"[A-Za-z0-9]+", name)).lstrip("-0123456789")
        near = near if near and not keyword.iskeyword(near) else "termsel-demo"
        raise TermselError(f"{name!r} cannot be the name of a package",
                           hint=f"Take letters, digits and hyphens, such as {near}.")
    # The module of an installed plugin may be its own earlier version, which is to be replaced.
    plugins = {point.module for point in entry_points(group="termsel")}
    if package != "termsel" and module not in plugins and find_spec(module) is not None:
        raise TermselError(f"Python already has a module {module!r}",
                           hint=f"Choose another name, such as termsel-{name}.")
    if package == "termsel":
        raise TermselError("this is the name of termsel itself", hint="Choose another name.")
    from termsel.plugins.commands import COMMANDS
    from termsel.plugins.kinds import KINDS as REGISTERED
    from termsel.plugins.registry import Registry

    plural = next((key for key, value in REGISTERED.items() if value.word == _name_as_word(kind)),
                  None)
    names_in_use = COMMANDS if plural is None else Registry([]).names(plural)
    if plugin_name in names_in_use:
        raise TermselError(f"termsel has a {_name_as_word(kind)} {plugin_name!r} itself",
                           hint="Choose another name.")
