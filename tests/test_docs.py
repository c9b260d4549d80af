"""The pages tell the truth: what they show runs, and what there is they name."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

import termsel
import termsel.testing
from termsel.plugins import hookspecs
from termsel.plugins.kinds import KINDS
from termsel.plugins.loading import HOOKS
from termsel.plugins.registry import registry

ROOT = Path(__file__).parents[1]
DOCS = sorted([*ROOT.glob("docs/*.md"), *ROOT.glob("docs/formats/*.md")])
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


snippets = _load(ROOT / "docs" / "snippets.py")


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


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md", "docs/simulated.md",
                                  "docs/plugins.md"])
def test_page_shows_what_its_snippets_print(page: str, tmp_path: Path) -> None:
    _plugin_of_the_readme(tmp_path)
    found = snippets.steps(_page(page))
    assert found
    for step in found:
        actual = snippets.run(step, tmp_path)
        if step.shown is not None:
            assert snippets.renewed(step.shown, actual) is not None, (
                f"{page}: {step.code}\nis shown to print\n{step.shown}\nand prints\n{actual}\n"
                f"python docs/snippets.py {page} renews the page")


def test_plugin_of_the_readme_is_a_plugin(tmp_path: Path) -> None:
    assert len(_block(_page("README.md"), "python", "class DLT").splitlines()) <= 25
    _plugin_of_the_readme(tmp_path)
    code = ("import sys; from termsel.__main__ import main; "
            "sys.argv[1:] = ['run', '--problem', 'owdis-lines', '--model', 'dlt-demo', "
            "'--generations', '2', '--set', 'population=20', '--set', 'polish=false']; main()")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "owdis-lines: model dlt-demo" in done.stdout
    assert "all 11 terms" in done.stdout or "11 of 11 terms" in done.stdout


def test_plugin_of_the_readme_passes_the_conformance_checks(tmp_path: Path) -> None:
    _plugin_of_the_readme(tmp_path)
    code = "from termsel.testing import check_model; from termsel_dlt import DLT; check_model(DLT)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_hook_is_documented_with_its_arguments() -> None:
    text = _page("docs/plugins.md")
    for hook in HOOKS:
        arguments = ", ".join(inspect.signature(getattr(hookspecs, hook)).parameters)
        assert f"### `{hook}({arguments})`" in text


@pytest.mark.parametrize("kind", KINDS)
def test_everything_with_a_name_is_named_in_the_docs(kind: str) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in [ROOT / "README.md", *DOCS])
    for entry in registry().entries(kind):
        if entry.provided_by in OWN:
            assert f"`{entry.name}`" in text, f"{kind}: {entry.name} is documented nowhere"


def test_every_public_name_is_in_the_reference() -> None:
    listed = set(re.findall(r"^   (\w+)$", _page("docs/api.md"), re.MULTILINE))
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
    text = page.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    names = re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE)
    # A name in front of a heading can be linked to from any page.
    names += re.findall(r"^\(([\w-]+)\)=$", "\n".join(p.read_text() for p in DOCS), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")
            for heading in headings} | set(names)


def test_readme_has_one_command_for_the_tests() -> None:
    found = re.search(r"<!-- tests -->\n```console\n\$ (.+)\n```\n<!-- /tests -->",
                      _page("README.md"))
    assert found is not None, ".ci/run looks for it"
    assert found[1].endswith("pytest")


def test_picture_is_of_the_run_the_readme_shows() -> None:
    picture = _page("docs/_static/owdis-lines.svg")
    readme = _page("README.md")
    selected = re.search(r"^Selected: (\d+) of 120 control features", readme, re.MULTILINE)
    accuracy = re.search(r"^selection +\d+ +[\d.]+ +[\d.]+ +([\d.]+)$", readme, re.MULTILINE)
    assert selected is not None
    assert accuracy is not None
    assert f">{selected[1]} selected lines<" in picture
    assert f">{float(accuracy[1]):.2f}<" in picture
