"""What pages show of the code: options as they are declared, and the keys of result.json.

A line ``<!-- generated: PART -->`` of a page stands for such a text, with all below it until
``<!-- /generated -->``, where the page has that: who reads it in a clone finds the same text there,
or how to see it. `filled` puts it in; Sphinx calls it when it reads a page, and the tests call it
to compare the page with the code. ``python docs/generated.py docs/how-to/kinds/*.md`` renews the
text between such lines.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import termsel.toolkit
from termsel.cli.new_plugin import package_files
from termsel.core.options import Option
from termsel.data.record.schema import json_schema
from termsel.plugins.commands import COMMANDS, GROUPS, PACKAGES
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import Entry, registry
from termsel.runs.request import DATA_OPTIONS
from termsel.selection.solvers.budget import SEARCH_OPTIONS

OF_EVERY_RUN = {"data": DATA_OPTIONS, "search": SEARCH_OPTIONS}
OWN = ("termsel", "termsel-app", "termsel-bench", "termsel-block", "termsel-formats",
       "termsel-cameras", "termsel-hybrids", "termsel-iiif", "termsel-match",
       "termsel-optimisers", "termsel-rpc", "termsel-sklearn", "termsel-standards",
       "termsel-studies")
"""Packages of the repository: others that happen to be installed are not documented here."""

_ONCE = ("RmseByRole", "SelectionRecord", "AdjustmentFigures", "FitRecord", "ScalingNumbers")
"""Parts of the schema that are shown where they stand at the top."""

PAGES = {"datasets": "data"}
"""Pages that are not called as the kind they list."""

_MARK = re.compile(r"^<!-- generated: ([\w. ]+) -->$"
                   r"(?:\n(?:(?!<!-- generated: )[\s\S])*?^<!-- /generated -->$)?", re.MULTILINE)
_SECTION = re.compile(r"^[A-Z]\w+\n-{3,}$", re.MULTILINE)


def filled(page: str) -> str:
    """Return the text of a page with what its marks stand for."""
    return _MARK.sub(lambda mark: part(mark[1]), page)


def renewed(page: str) -> str:
    """Return a page whose marks have what they stand for below them, for readers of the file."""
    return _MARK.sub(lambda mark: "\n".join([
        f"<!-- generated: {mark[1]} -->", part(mark[1]), "<!-- /generated -->"]), page)


def part(name: str) -> str:
    """Return the Markdown that one mark stands for."""
    what, _, kind = name.partition(" ")
    if what == "names":
        return "\n".join(
            f"| [{KINDS[kind].word}]({PAGES.get(kind, kind)}.md) | "
            + ", ".join(f"`{entry.name}`" for entry in entries(kind)) + " |" for kind in KINDS)
    if what == "package":
        return _of_package(*kind.split())
    if what == "commands":
        return "\n".join(_commands())
    if what == "toolkit":
        stubs = sorted(Path(termsel.toolkit.__file__).parent.glob("*.pyi"))
        return "\n".join(line for stub in stubs for line in _toolkit(stub))
    if what == "schema":
        rows = keys(json_schema())
        return "\n".join(["| key | type | meaning |", "|---|---|---|", *rows])
    if kind in OF_EVERY_RUN:
        return "\n".join(table(OF_EVERY_RUN[kind]))
    if kind == "datasets":
        rows = [f"| `{entry.name}` | {entry.summary} | `{entry.provided_by}` |"
                for entry in entries(kind)]
        return "\n".join(["| name | measurements | package |", "|---|---|---|", *rows])
    return "\n".join(line for entry in entries(kind) for line in section(kind, entry))


def _commands() -> Iterator[str]:
    """Yield a section for each group of commands, with all that are installed."""
    packages = {name: package.replace("_", "-") for package, names in PACKAGES.items()
                for name in names if find_spec(package) is not None}
    for group, names in GROUPS.items():
        yield from (f"## {group}", "")
        for name in names:
            if name not in COMMANDS and name not in packages:
                continue
            yield from ("```{eval-rst}", f".. click:: commands:{name.replace('-', '_')}",
                        f"   :prog: termsel {name}", "")
            yield from (f"Of the package {packages[name]}.", "") if name in packages else ()
            yield from ("```", "")


def _toolkit(stub: Path) -> Iterator[str]:
    """Yield a section and a table of the names of a stub."""
    module_of_names = ".".join(["termsel.toolkit", *[stub.stem] * (stub.stem != "__init__")])
    summary = ast.get_docstring(ast.parse(stub.with_suffix(".py").read_text(encoding="utf-8")))
    place = Path(termsel.__file__).parent
    yield from ("", f"## {module_of_names}", "", (summary or "").partition("\n\n")[0], "",
                "| name | what it is |", "|---|---|")
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        assert isinstance(node, ast.ImportFrom)
        module = str(node.module).removeprefix("termsel.")
        for name in (alias.name for alias in node.names):
            path = place.joinpath(*module.split("."))
            source = path.with_suffix(".py") if path.with_suffix(".py").exists() else \
                path / "__init__.py"
            said = _said(ast.parse(source.read_text(encoding="utf-8")).body, name)
            yield f"| `{name}` | {said.replace('|', chr(92) + '|')} |"


def _said(body: list[ast.stmt], name: str) -> str:
    """Return the first sentence on a function, class or constant of a module; "" if none."""
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name == name:
            return (ast.get_docstring(node) or "").partition("\n")[0]
        targets = node.targets if isinstance(node, ast.Assign) else [
            node.target] if isinstance(node, ast.AnnAssign) else []
        if any(isinstance(target, ast.Name) and target.id == name for one in targets
               for target in (one.elts if isinstance(one, ast.Tuple) else [one])):
            text = after.value.value if isinstance(after, ast.Expr) and isinstance(
                after.value, ast.Constant) else ""
            return " ".join(str(text).split())
    return ""


def _of_package(kind: str, file: str) -> str:
    """Return a file of the package that `termsel new-plugin` writes."""
    text = next(text for path, text in package_files("termsel-demo", kind).items()
                if Path(path).name == file)
    return f"```{Path(file).suffix[1:].replace('py', 'python')}\n{text}```"


def entries(kind: str) -> list[Entry]:
    """Return everything of a kind that the repository provides."""
    return [entry for entry in registry().entries(kind) if entry.provided_by in OWN]


def section(kind: str, entry: Entry) -> Iterator[str]:
    """Yield what a page says of one thing: its description and its options."""
    thing = entry.object
    yield from (f"({KINDS[kind].word.replace(' ', '-')}-{entry.name})=", f"## {entry.name}", "")
    yield from (description(kind, entry), "")
    facts = [f"- {key}: {value}" for key, value in about(kind, entry) if value]
    yield from (*facts, *([""] if facts else []))
    options = getattr(thing, "options" if kind == "problems" else "declared_options", ())
    yield from table(options) if options else ["No options."]
    yield ""


def description(kind: str, entry: Entry) -> str:
    """Return the paragraphs of a docstring, or the summary of what has none."""
    if kind in ("problems", "objectives", "methods", "splits", "sections", "measures"):
        return entry.summary
    thing = entry.object
    text = inspect.cleandoc((thing if isinstance(thing, type) else type(thing)).__doc__ or "")
    return _SECTION.split(text)[0].strip().replace("*", r"\*").replace("``", "`")


def about(kind: str, entry: Entry) -> list[tuple[str, str]]:
    """Return further facts, by their name."""
    thing = entry.object
    package = [("Package", "" if entry.provided_by == "termsel" else f"`{entry.provided_by}`")]
    if kind == "problems":
        settings = "".join(f" --set {key}={value}" for key, value in thing.model_options.items())
        return [*package,
                ("Model", f"`{thing.model}{settings}`"), ("Data set", f"`{thing.dataset}`"),
                ("Criterion", f"`{thing.criterion}`"), ("Solver", f"`{thing.solver}`"),
                ("Control", thing.control), ("Source", thing.source)]
    if kind == "models":
        return [*package, ("Heights", "required" if thing.uses_height else "not used")]
    if kind == "solvers":
        return [*package, ("Objectives", f"at most {thing.max_objectives}"),
                ("Ends", "by itself" if thing.ends_by_itself else "with the budget"),
                ("Differences from the paper", " ".join(thing.departures))]
    return package


def table(options: Iterable[Option]) -> list[str]:
    """Return the rows of a table of options."""
    rows = ["| key | default | accepts | meaning |", "|---|---|---|---|"]
    for one in options:
        default = "not set" if one.default in (None, "") else _text(one.default)
        accepts = " ".join(f"`{choice}`" for choice in one.choices) or one.accepts
        rows.append("| " + " | ".join(
            cell.replace("|", r"\|").replace("*", r"\*")
            for cell in (f"`{one.name}`", default, accepts, one.doc)) + " |")
    return rows


def _text(value: Any) -> str:
    if value == "":
        return "none"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def keys(schema: Mapping[str, Any], path: str = "", whole: Mapping[str, Any] | None = None,
         ) -> list[str]:
    """Return a row for each key of a JSON Schema, those of what a key refers to included.

    Parameters
    ----------
    schema : mapping
    path : str
        The key this schema is of.
    whole : mapping, optional
        The schema that holds the definitions; this one by default.
    """
    whole = schema if whole is None else whole
    rows = []
    for name, one in schema.get("properties", {}).items():
        key = f"{path}.{name}" if path else name
        rows += _rows(one, key, whole, name in schema.get("required", ()))
    return rows


def _rows(one: Mapping[str, Any], key: str, whole: Mapping[str, Any], always: bool) -> list[str]:
    target = _resolved(one, whole)
    meaning = one.get("description") or target.get("description", "")
    meaning += "" if always else " Not always there."
    enum = ", ".join(f"`{json.dumps(value)}`" for value in target.get("enum", ()))
    rows = [f"| `{key}` | {_type(one, whole)} | {meaning}{f' One of {enum}.' if enum else ''} |"]
    if "$ref" in one and path_of(one) in _ONCE and "." in key:
        return rows  # shown once, where it stands at the top
    for branch in (target, *(_resolved(other, whole) for other in target.get("anyOf", ())
                             if "." not in key or path_of(other) not in _ONCE)):
        rows += keys(branch, key, whole)
        for part_key, inside in ((f"{key}[]", branch.get("items")),
                                 (f"{key}.*", branch.get("additionalProperties"))):
            if isinstance(inside, dict) and "properties" in _resolved(inside, whole):
                rows += keys(_resolved(inside, whole), part_key, whole)
    return rows


def path_of(one: Mapping[str, Any]) -> str:
    """Return the name of the definition that a schema refers to."""
    return str(one.get("$ref", "")).rpartition("/")[2]


def _resolved(one: Mapping[str, Any], whole: Mapping[str, Any]) -> Mapping[str, Any]:
    return whole["$defs"][path_of(one)] if "$ref" in one else one


def _type(one: Mapping[str, Any], whole: Mapping[str, Any]) -> str:
    target = _resolved(one, whole)
    if "anyOf" in target:
        return " or ".join(_type(other, whole) for other in target["anyOf"])
    if "const" in target:
        return f"`{json.dumps(target['const'])}`"
    kind = target.get("type", "any" if "enum" not in target
                      else "boolean" if target["enum"] == [False] else "string")
    return kind if isinstance(kind, str) else " or ".join(kind)


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        path.write_text(renewed(path.read_text(encoding="utf-8")), encoding="utf-8")
