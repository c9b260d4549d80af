"""Names and options on a page exist: of commands, formats, problems, models and so on."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import pytest

from termsel.cli.main import cli
from termsel.io.read import read_options
from termsel.plugins.commands import COMMANDS
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import registry
from termsel.runs.request import DATA_OPTIONS
from termsel.selection.solvers.budget import SEARCH_OPTIONS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("plugins/*/README.md")),
         *(page for page in sorted(ROOT.glob("docs/**/*.md")) if "_build" not in page.parts)]
NAMED = {"--problem": ("problems",), "--model": ("models", "methods"), "--solver": ("solvers",),
         "--criterion": ("criteria",), "--dataset": ("datasets",), "--to": ("writers",),
         "--export": ("writers",), "--format": ("readers",)}
TABLES = {"problem": ("problems",), "model": ("models", "methods"), "solver": ("solvers",),
          "criterion": ("criteria",), "reader": ("readers",), "writer": ("writers",),
          "format": ("readers", "writers")}
MADE = {"dlt-demo", "line-demo", "demo"}
"""What pages make themselves."""
SCRIPTS = {"--cases", "--first", "--names", "--runs", "--seconds"}
"""Options of benchmarks, of the walks and of the fuzz suite."""
OTHERS = {"case-2", "case-3", "date-released", "deap-script", "gdal-polynomial", "owdis-block",
          "pymoo-script", "scikit-learn", "start-1", "start-4",
          "vendor-rpc"}
"""What has the form of a name and is none: clauses, keys of other files, ids, and what benchmark
and blocks call by name."""


@cache
def names(*kinds: str) -> set[str]:
    return {entry.name for kind in kinds for entry in registry().entries(kind)} | MADE


@cache
def options() -> dict[str, tuple[str, ...]]:
    """Return all options by name, with their choices."""
    found: dict[str, tuple[str, ...]] = {
        option.name: tuple(map(str, option.choices or ()))
        for option in (*DATA_OPTIONS, *SEARCH_OPTIONS, *read_options())}
    for kind in KINDS:
        for entry in registry().entries(kind):
            declared = entry.object.options if kind == "problems" else getattr(
                entry.object, "declared_options", ())
            found |= {option.name: tuple(map(str, option.choices or ())) for option in declared}
    return found


def prose(text: str) -> str:
    return re.sub(r"^ *```.*?^ *```$", "", text, flags=re.MULTILINE | re.DOTALL)


def commands(text: str) -> Iterator[list[str]]:
    """Yield the words of every command of termsel on a page, run or not, and of bare options.

    Not those that the page shows to be refused.
    """
    text = re.sub(r"^\$ .*\nError: .*$", "", text, flags=re.MULTILINE)
    code = re.findall(r"`((?:termsel |--)[^`]+)`", prose(text))
    for block in re.findall(r"^( *)```(?:sh|console)\n(.*?)^\1```$", text,
                            re.MULTILINE | re.DOTALL):
        code += block[1].replace("\\\n", " ").splitlines()
    code += re.findall(r"^    (termsel .*)$", text, re.MULTILINE)
    for line in code:
        for part in re.split(r" && | \| |; | # |, then ", line):
            found = re.search(r"(?:^|\$ |^do | do )\s*(termsel .*|--.*)", part)
            if found:
                yield shlex.split(found[1].replace("...", "").replace("…", ""))


def wrong(words: list[str]) -> Iterator[str]:
    """Yield what does not exist of a command, or of options alone."""
    command = None
    if words[0] == "termsel":
        if len(words) == 1 or not re.fullmatch(r"[a-z][a-z-]*", words[1]):
            return
        command = cli.get_command(click.Context(cli), words[1])
        if command is None and registry().missing(words[1]):
            return
        if command is None:
            yield f"no command {words[1]}"
            return
    known = spelled(command)
    for word, value in zip(words[1:] if command else words, [*words[2:], ""] if command
                           else [*words[1:], ""], strict=True):
        name, _, joined = word.partition("=")
        if re.fullmatch(r"-[a-zA-Z]|--[a-z][a-z-]*", name) and name not in known | SCRIPTS:
            yield f"{command.name} has no option {name}" if command else f"no command has {name}"
        if name in NAMED:
            for one in (joined or value).split(","):
                if re.fullmatch(r"[a-z][a-z0-9-]*", one) and one not in names(*NAMED[name]) \
                        and not registry().missing(one):
                    yield f"{name} {one}"
        if name == "--set":
            yield from wrong_setting(value)
    thing = words[2] if len(words) > 2 else "NAME"
    known = {"describe": names(*KINDS) | {"data"},
             "list": set(KINDS)}.get(command.name or "", {thing}
                                                                ) if command else {thing}
    if not thing.isupper() and thing not in known:
        yield f"{words[1]} {thing}"


@cache
def spelled(command: click.Command | None) -> set[str]:
    every = [command] if command else [
        cli.get_command(click.Context(cli), name)
        for name in (*COMMANDS, *registry().names("commands"))]
    return {"--help", "--version", "-h"} | {
        name for one in every if one is not None for param in one.params
        if isinstance(param, click.Option) for name in (*param.opts, *param.secondary_opts)}


def wrong_setting(text: str) -> Iterator[str]:
    key, equals, value = text.partition("=")
    name = key.rpartition(".")[2]
    if not equals or not re.fullmatch(r"[a-z_0-9]+", name):
        return
    if name not in options():
        yield f"--set {key}"
    choices = options().get(name, ())
    if choices and re.fullmatch(r"[a-z][a-z-]*", value) and value not in choices:
        yield f"--set {text}"


def rows(text: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield kinds and name of each row of a table about things of one kind."""
    for table in re.findall(r"(?:^\|.*\|$\n?){3,}", text, re.MULTILINE):
        head, _, *body = table.splitlines()
        kinds = TABLES.get(head.split("|")[1].strip().lower())
        for row in body if kinds else ():
            if name := re.fullmatch(r"`([\w-]+)`", row.split("|")[1].strip()):
                yield kinds or (), name[1]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_page_names_what_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    found = [f"{shlex.join(words)}: {what}" for words in commands(text) for what in wrong(words)]
    found += [f"table: {name}" for kinds, name in rows(text)
              if name not in names(*kinds) and not registry().missing(name)]
    values = {choice for choices in options().values() for choice in choices}
    known = names(*KINDS) | {*COMMANDS, *registry().names("commands")} | values | OTHERS
    found += [f"`{name}`" for name in re.findall(r"`([a-z0-9]+(?:-[a-z0-9]+)+)`", prose(text))
              if name not in known and not registry().missing(name)]
    assert not found


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_what_exists(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    help_text = re.sub(r"\\\n\s*", "", command.help or "")
    examples = re.findall(r"^ *termsel .*$", help_text, re.MULTILINE)
    assert examples
    text = "".join(f"    {line.strip()}\n" for line in examples)
    assert not [what for words in commands(text) for what in wrong(words)]


@pytest.mark.parametrize(("text", "said"), [
    ("`termsel compare --export gdal-vrt`", "--export gdal-vrt"),
    ("```sh\ntermsel run --problem rfm-term --out x\n```", "--problem rfm-term"),
    ("```console\n$ for s in 1 2; do termsel run --sed $s; done\n```", "run has no option --sed"),
    ("`termsel export result --to rpc`", "--to rpc"), ("`termsel plam DIR`", "no command plam"),
    ("`--set polished=true`", "--set polished"), ("`--set denominators=none-at-all`", "--set den"),
    ("    termsel describe gaa", "describe gaa"), ("`--solver ga,icaa`", "--solver icaa"),
    ("`--crss EPSG:4326`", "no command has --crss")])
def test_names_that_do_not_exist_are_found(text: str, said: str) -> None:
    found = [what for words in commands(text) for what in wrong(words)]
    assert any(said in what for what in found), found
