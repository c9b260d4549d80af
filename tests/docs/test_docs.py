"""The pages tell the truth: what they show runs, and what there is they name."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
import tomllib
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import termsel
import termsel.testing
from termsel.core.options import Configurable
from termsel.data.record.schema import json_schema
from termsel.plugins import hookspecs
from termsel.plugins.kinds import KINDS
from termsel.plugins.loading import HOOKS
from termsel.plugins.registry import registry
from termsel.runs.request import DATA_OPTIONS
from termsel.testing import check

ROOT = Path(__file__).parents[2]
DOCS = sorted(page for page in ROOT.glob("docs/**/*.md") if "_build" not in page.parts)
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md",
         *sorted(ROOT.glob("plugins/*/README.md")), *DOCS]
OWN = {"termsel", *(path.name for path in ROOT.glob("plugins/*"))}


def _load(path: Path) -> ModuleType:
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


generated = _load(ROOT / "docs" / "generated.py")
PICTURE = "docs/_static/owdis-lines.svg"
SECTIONS = ["tutorial", "how-to", "how-to/gallery", "reference", "explanation", "evidence"]


def _page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _block(text: str, language: str, holding: str) -> str:
    blocks = re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return next(block for block in blocks if holding in block)


def _plugin_of_the_readme(folder: Path) -> None:
    """Install the README's plugin into a folder, as far as Python looks at it."""
    text = _page("README.md")
    (folder / "termsel_dlt.py").write_text(_block(text, "python", "class DLT"))
    project = tomllib.loads(_block(text, "toml", "build-system"))["project"]
    info = folder / f"termsel_dlt-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    points = project["entry-points"]["termsel"]
    (info / "entry_points.txt").write_text(
        "[termsel]\n" + "".join(f"{name} = {module}\n" for name, module in points.items()))


def test_plugin_of_the_readme_is_a_plugin(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, only: Callable[[str], None],
        call: Callable[..., Any]) -> None:
    assert len(_block(_page("README.md"), "python", "class DLT").splitlines()) <= 25
    _plugin_of_the_readme(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    only("termsel-dlt")
    done = call("run", "--problem", "owdis-lines", "--model", "dlt-demo", "--generations", 2,
                "--set", "population=20", "--set", "polish=false")
    assert done.exit_code == 0, done.stderr
    assert "Model     dlt-demo, all " in done.stdout
    assert "all 11 terms" in done.stdout or "11 of 11 terms" in done.stdout


def test_plugin_of_the_readme_passes_the_conformance_checks(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _plugin_of_the_readme(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    check(importlib.import_module("termsel_dlt").DLT)


def test_every_hook_is_documented_with_its_arguments() -> None:
    text = _page("docs/reference/plugins.md")
    for hook in HOOKS:
        arguments = ", ".join(inspect.signature(getattr(hookspecs, hook)).parameters)
        assert f"### `{hook}({arguments})`" in text


def test_hooks_of_the_reference_return_classes_of_what_has_options() -> None:
    returned = []
    for code in re.findall(r"^```python\n(.*?)^```", _page("docs/reference/plugins.md"),
                           re.MULTILINE | re.DOTALL):
        scope: dict[str, Any] = {}
        exec(code, scope)
        returned += [thing for kind in KINDS for thing in scope.get(f"termsel_{kind}", list)()]
    assert returned
    assert not [thing for thing in returned if isinstance(thing, Configurable)]


@pytest.mark.parametrize("kind", KINDS)
def test_everything_with_a_name_is_named_in_the_docs(kind: str) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in [ROOT / "README.md", *DOCS])
    for entry in registry().entries(kind):
        if entry.provided_by in OWN:
            assert f"`{entry.name}`" in text, f"{kind}: {entry.name} is documented nowhere"


def test_every_public_name_is_in_the_reference() -> None:
    pages = "".join(_page(f"docs/reference/{name}.md") for name in ("api", "api-authors"))
    listed = set(re.findall(r"^   (\w+)$", pages, re.MULTILINE))
    assert {*termsel.__all__, *termsel.testing.__all__} - listed == {"__version__"}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"),
                  flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        assert file.exists(), f"{target} leads nowhere"
        if anchor and file.suffix == ".md":
            assert anchor in _anchors(file), f"{target}: no such heading"


def _anchors(page: Path) -> set[str]:
    text = generated.filled(page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    names = re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE)
    # A name in front of a heading can be linked to from any page.
    names += re.findall(r"^\(([\w-]+)\)=$", "\n".join(p.read_text() for p in DOCS), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")
            for heading in headings} | set(names)


@pytest.mark.parametrize("page", sorted((ROOT / "docs/how-to/kinds").glob("*.md")),
                         ids=lambda path: path.name)
def test_the_file_of_a_page_has_the_packages_it_shows(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == generated.renewed(text), f"run python docs/generated.py {page}"


def test_readme_has_one_command_for_the_tests() -> None:
    found = re.search(r"<!-- tests -->\n```console\n\$ (.+)\n```\n<!-- /tests -->",
                      _page("README.md"))
    assert found is not None, ".ci/run looks for it"
    assert found[1].endswith("pytest")


def test_picture_is_of_the_run_the_readme_shows() -> None:
    selected = re.search(r"^Model .*, (\d+) of \d+ lines,", _page("docs/explanation/lines.md"),
                         re.MULTILINE)
    assert selected is not None
    roles = {name: role for name, (role, _) in _marks(_page(PICTURE)).items()}
    lines = [role for name, role in roles.items() if name.startswith("L")]
    assert len(lines) == 120
    assert lines.count("control") == int(selected[1])


@pytest.mark.slow
def test_picture_is_what_the_command_of_the_readme_draws(call: Any, tmp_path: Path) -> None:
    folder, drawn = tmp_path / "result", tmp_path / "owdis-lines.svg"
    page = _page("docs/explanation/lines.md")
    assert "`termsel plot result residuals -o owdis-lines.svg`" in page
    for words in (["run", "--problem", "owdis-lines", "--out", folder],
                  ["plot", folder, "residuals", "-o", drawn]):
        assert call(*words).exit_code == 0
    expected, actual = _marks(_page(PICTURE)), _marks(drawn.read_text())
    # Not the selection: another processor may round otherwise, and then find another.
    assert expected.keys() == actual.keys()
    for name, (_, place) in expected.items():
        assert actual[name][1] == pytest.approx(place, abs=0.5), name  # px of the picture


def _marks(picture: str) -> dict[str, tuple[str, tuple[float, float]]]:
    """Return the role and place of each feature of a picture, by its id."""
    return {name: (role, (float(x), float(y))) for role, name, x, y in re.findall(
        r'<path aria-label="[^"]*role: ([\w ]+); id: (\w+);[^"]*"[^>]*'
        r'transform="translate\(([-\d.]+),([-\d.]+)\)', picture)}


def _toctree(page: Path) -> list[Path]:
    """Return the pages that the toctrees of a page list."""
    found = re.findall(r"^```{toctree}\n(?::\w+:[^\n]*\n)*\n(.*?)^```$",
                       page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [(page.parent / f"{name}.md").resolve() for tree in found for name in tree.split()]


def test_sidebar_has_six_entries() -> None:
    assert _toctree(ROOT / "docs/index.md") == [
        ROOT / "docs" / section / "index.md" for section in SECTIONS]


def test_every_page_is_reached_from_the_landing_page() -> None:
    reached, ahead = set(), [ROOT / "docs/index.md"]
    while ahead:
        page = ahead.pop()
        assert page not in reached, f"{page} is listed twice"
        reached.add(page)
        ahead += _toctree(page)
    assert reached == set(DOCS)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "datasets"])
def test_every_declared_option_is_in_the_reference(kind: str) -> None:
    text = generated.filled(_page(f"docs/reference/options/{kind}.md"))
    for entry in registry().entries(kind):
        if entry.provided_by not in OWN:
            continue
        section = re.search(rf"^## {re.escape(entry.name)}$(.*?)(?=^## |\Z)", text,
                            re.MULTILINE | re.DOTALL)
        assert section is not None, f"{entry.name} has no section"
        options = getattr(entry.object, "options" if kind == "problems" else "declared_options", ())
        for option in options:
            assert f"| `{option.name}` |" in section[1], f"{entry.name}: {option.name}"
            assert option.doc.replace("|", r"\|").replace("*", r"\*") in section[1]


def test_options_of_the_data_and_data_sets_are_in_the_reference() -> None:
    text = generated.filled(_page("docs/reference/options/data.md"))
    for option in DATA_OPTIONS:
        assert f"| `{option.name}` |" in text
    for entry in registry().entries("datasets"):
        assert entry.provided_by not in OWN or f"| `{entry.name}` |" in text


def test_names_are_listed_with_the_options() -> None:
    text = generated.filled(_page("docs/reference/options/index.md"))
    for kind in KINDS:
        for entry in registry().entries(kind):
            assert entry.provided_by not in OWN or f"`{entry.name}`" in text


def test_every_key_of_the_record_is_in_the_reference() -> None:
    text = generated.filled(_page("docs/reference/result.md"))
    schema = json_schema()
    for key in (*schema["properties"], "rmse.independent.total", "baselines[].name",
                "strategy.candidates[].effective", "significance.*.t", "front[].rmse"):
        assert f"| `{key}` |" in text


TERMS = """
    GCP; GCL; control feature; selection point; independent check point; role; line; sample; CRS;
    DEM; RPC; RPC00B; RFM; DLT; term; selection; design matrix; adjustment; residual; redundancy;
    degrees of freedom; RMSE; leave-one-out; PRESS; CE90; OWDIS; empire; imperialist; colony;
    assimilation; chromosome; genome; Pareto front; knee; pole; pseudo-observation; ridge;
    effective parameters; blunder; outlier; hold out; fold; local refinement; baseline; candidate;
    certificate; sealed; violation; fitness; predicted RMSE; geoid; ellipsoidal height
"""


def test_glossary_defines_the_terms_of_the_field() -> None:
    text = re.search(r"^```{glossary}\n(.*?)^```$", _page("docs/explanation/glossary.md"),
                     re.MULTILINE | re.DOTALL)
    assert text is not None
    defined = re.findall(r"^(\S.*)$", text[1], re.MULTILINE)
    assert {term.strip() for term in TERMS.replace("\n", " ").split(";")} - set(defined) == set()
    assert len(defined) == len(set(defined)), "a term is defined twice"


def test_no_page_names_a_path_that_does_not_exist() -> None:
    sources = [*PAGES, *ROOT.glob("docs/**/*.py"), *ROOT.glob("benchmarks/*"),
               *ROOT.glob("src/**/*.py"), *(ROOT / "tests").glob("test_*.py"),
               *ROOT.glob("plugins/*/src/**/*.py")]
    named = re.compile(r"(?<![\w./-])(?:docs|src|tests|benchmarks|plugins)/[\w./-]*\w")
    for source in sources:
        # The files of test_lint.py are examples, made where it runs.
        if source.is_dir() or "_build" in source.parts or source.name == "test_lint.py":
            continue
        for path in named.findall(source.read_text(encoding="utf-8")):
            # Where the documentation is built to is not there before.
            assert ((ROOT / path).exists() or (source.parent / path).exists()
                    or path == "docs/_build"), f"{source}: {path}"
