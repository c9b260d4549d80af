"""The registry: built-ins through hooks, third parties in isolation."""

import inspect
import json
import re
import sys

import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.isolation.parts import is_left_out, own_packages
from termsel.core.options import options_by_part
from termsel.io.read import READ_OPTIONS, read_options
from termsel.plugins import builtin, hookspecs
from termsel.plugins.kinds import KINDS
from termsel.plugins.loading import HOOKS
from termsel.plugins.registry import Registry
from termsel.plugins.registry import registry as process_registry
from termsel.plugins.requirements import version_fits
from tests.plugin_texts import BROKEN, INSTANCE, MODEL, NEW_RULE

BUILT_IN = {
    "problems": {"rfm-terms", "rfm-terms-lines", "poly-terms", "owdis-points", "owdis-lines",
                 "owdis-points-terms", "owdis-lines-terms"},
    "models": {"rfm", "poly2d", "poly3d", "affine"},
    "solvers": {"ga", "swap", "random", "all-terms"},
    "criteria": {"check-rmse"},
    "datasets": {"ikonos-hamedan", "spot-isfahan", "irs1c-mashad"},
    "readers": {"points-csv", "lines-csv"},
}


@pytest.mark.parametrize("kind", BUILT_IN)
def test_built_ins_are_registered(kind):
    names = Registry([])
    assert set(names.names(kind)) >= BUILT_IN[kind]
    assert not names.failures()
    assert {entry.provided_by for entry in names.entries(kind)} == {"termsel"}


@pytest.mark.parametrize("kind", BUILT_IN)
def test_built_ins_say_what_they_are(kind):
    for entry in Registry([]).entries(kind):
        assert entry.summary, entry.name
        assert "\n" not in entry.summary


def test_built_ins_come_by_hooks_alone():
    implemented = {name for name in vars(builtin) if name.startswith("termsel_")}
    assert implemented <= set(HOOKS)
    assert set(Registry([]).plugins[0].hooks) == implemented


@pytest.mark.parametrize("hook", HOOKS)
def test_every_hook_is_documented(hook):
    specification = getattr(hookspecs, hook)
    text = inspect.getdoc(specification)
    assert text.partition("\n")[0].endswith(".")
    for argument in inspect.signature(specification).parameters:
        assert f"{argument} : " in text
    assert inspect.signature(specification).return_annotation == "None" or "Returns\n---" in text


def test_every_kind_has_a_hook():
    assert {f"termsel_{kind}" for kind in KINDS} | {
        "termsel_commands", "termsel_observers", "termsel_parts",
        "termsel_run_finished"} == set(HOOKS)


def test_parts_of_plugins_are_asked_for_and_what_is_none_is_told(install, registry, capsys):
    install("good", """
        from termsel import hookimpl
        from termsel.toolkit import Part
        @hookimpl
        def termsel_parts(): return [Part("study", 1), Part("scheduler", 2)]""")
    install("bad", """
        from termsel import hookimpl
        @hookimpl
        def termsel_parts(): return ["study"]""")
    known = registry()
    assert [(part.slot, part.value) for part in known.parts()] == [("study", 1), ("scheduler", 2)]
    assert "returned an object of type str, not a Part" in capsys.readouterr().err


def test_a_plugin_provides_a_model(install, registry):
    install("dlt-demo-package", MODEL.format(name="dlt-demo"))
    names = registry()
    entry = names.entries("models")[-1]
    assert (entry.name, entry.provided_by) == ("dlt-demo", "dlt-demo-package")
    assert entry.summary == "Direct linear transformation: one shared denominator, 11 terms."
    assert len(names.get("models", "dlt-demo")().terms) == 11
    assert names.get("models", "DLT_demo.package:dlt-demo") is entry.object
    assert names.failures() == []


@pytest.mark.parametrize(("code", "reason"), BROKEN.values(), ids=BROKEN)
def test_a_broken_plugin_harms_nothing_else(install, registry, code, reason):
    install("a-broken-one", code, version="0.3")
    install("b-sound-one", MODEL.format(name="sound"))
    names = registry()
    (failure,) = names.failures()
    assert reason in failure.what
    assert (failure.plugin, failure.distribution, failure.version) \
        == ("a_broken_one", "a-broken-one", "0.3")
    assert "\n" not in str(failure)
    assert names.names("models") == [*Registry([]).names("models"), "sound"]
    assert [p.distribution for p in names.plugins] == ["termsel", "a-broken-one", "b-sound-one"]


def test_other_hooks_of_a_plugin_with_an_unknown_one_count(install, registry):
    install("newer", MODEL.format(name="kept") + """
    @hookimpl
    def termsel_cameras():
        return []
    """)
    names = registry()
    assert names.get("models", "kept").name == "kept"
    assert "termsel_cameras" in names.failures()[0].what
    assert names.plugins[1].hooks == ("termsel_models",)


def test_a_clash_keeps_the_built_in(install, registry):
    install("rival", MODEL.format(name="rfm"))
    names = registry()
    assert names.get("models", "rfm").__module__ == "termsel.models.quotient"
    assert names.get("models", "termsel:rfm") is names.get("models", "rfm")
    assert names.get("models", "rival:rfm").__module__ == "rival"
    listed = [(e.name, e.provided_by) for e in names.entries("models") if "rfm" in e.name]
    assert listed == [("rfm", "termsel"), ("rival:rfm", "rival")]
    (failure,) = names.failures()
    assert "'rfm', a name that termsel has too; 'rival:rfm' selects this one" in failure.what


def test_between_third_parties_the_first_by_distribution_keeps_the_name(install, registry):
    install("zebra", MODEL.format(name="same"), name="a")
    install("ant", MODEL.format(name="same"), name="z")
    names = registry()
    assert names.get("models", "same").__module__ == "ant"
    assert names.get("models", "zebra:same").__module__ == "zebra"
    assert [failure.distribution for failure in names.failures()] == ["zebra"]


def test_a_name_given_twice_by_one_plugin_counts_once(install, registry):
    install("twice", MODEL.format(name="dup").replace("return [DLT]", "return [DLT, DLT]"))
    names = registry()
    assert names.names("models").count("dup") == 1
    assert "twice; only the first is kept" in names.failures()[0].what


def test_an_instance_where_a_class_is_wanted_is_refused(install, registry):
    install("old-rule", INSTANCE)
    names = registry()
    assert [failure.what for failure in names.failures()] == [
        "termsel_criteria: TypeError: returned an object of type Quantile, not a subclass of "
        "Criterion; return the class"]
    assert "quantile" not in names.names("criteria")
    module = sys.modules["old_rule"]
    assert isinstance(names.resolve("criteria", module.Quantile()), module.Quantile)
    with pytest.raises(TermselError, match="nothing that termsel has names for"):
        names.register(module.Quantile())


@pytest.mark.parametrize("kind", NEW_RULE)
def test_what_has_options_is_returned_as_its_class(install, registry, kind):
    install("new-rule", NEW_RULE[kind])
    names = registry()
    assert inspect.isclass(names.get(kind, "new"))
    assert names.failures() == []


@pytest.mark.parametrize("kind", KINDS)
def test_built_ins_follow_the_one_rule(kind):
    names = Registry([])
    assert all(inspect.isclass(entry.object) == (
        kind not in ("problems", "objectives", "methods", "datasets", "splits"))
               for entry in names.entries(kind))


def test_a_class_is_kept_next_to_an_instance_that_is_refused(install, registry):
    install("twice", NEW_RULE["readers"].replace("[New]", "[New, New()]"))
    names = registry()
    assert "return the class" in names.failures()[0].what
    assert names.names("readers").count("new") == 1


def test_an_unknown_name_lists_the_known_ones_and_who_may_have_it(install, registry):
    with pytest.raises(TermselError, match="Did you mean 'rfm'") as found:
        Registry([]).get("models", "rfn")
    assert re.search("Known: affine, dlt2d, .*, poly2d, .*rfm, tps\\.$", str(found.value))
    assert "plugin" not in str(found.value)
    install("a-broken-one", "import no_such_module")
    with pytest.raises(TermselError, match=r"does not work \(a-broken-one\): see termsel plugins"):
        registry().get("models", "fancy")
    with pytest.raises(TermselError, match=r"package termsel-hybrids, which is not installed\. "
                                           r"In a clone of termsel: pip install "
                                           r"\./plugins/termsel-hybrids$"):
        Registry([]).get("models", "multiquadric")
    install("termsel-hybrids", """
        from termsel import hookimpl

        @hookimpl
        def termsel_models():
            return []
    """)
    with pytest.raises(TermselError, match="unknown model 'multiquadric'") as found:
        registry().get("models", "multiquadric")
    assert "not installed" not in str(found.value)


@pytest.mark.parametrize("kind", [*KINDS, "commands"])
def test_all_that_packages_of_this_project_provide_is_known_without_them(kind):
    known = own_packages()
    assert {entry.full_name for entry in process_registry().entries(kind)
            if entry.provided_by in known
            and entry.name not in known[entry.provided_by]} == set()


def test_all_options_of_packages_of_this_project_are_known_without_them():
    """An option of a package that is not installed is answered with the name of that package."""
    built_in = {option.name for option in READ_OPTIONS}
    of_packages = {("termsel-cameras", option.name) for option in read_options()
                   if option not in READ_OPTIONS}
    for kind in KINDS:
        for entry in process_registry().entries(kind):
            names = {option.name for option in getattr(entry.object, "declared_options", ())}
            if entry.provided_by == "termsel":
                built_in |= names
            elif entry.provided_by in own_packages():
                of_packages |= {(entry.provided_by, name) for name in names}
    missing = {(package, name) for package, name in of_packages
               if name not in built_in and f"--set {name}" not in own_packages()[package]}
    assert missing == set()


def test_an_option_of_a_package_that_is_left_out_names_it(monkeypatch):
    monkeypatch.setenv("TERMSEL_PLUGINS", "")
    with pytest.raises(TermselError, match=r"unknown option 'camera_focal'.*It is an option of the "
                                           "package termsel-cameras, which is"):
        options_by_part({"camera_focal": "3600"}, {"model": ()})


def test_a_plugin_is_asked_once(install, registry):
    install("counting", """
        from termsel import hookimpl
        calls = []
        @hookimpl
        def termsel_models():
            calls.append(1)
            return []
        """)
    names = registry()
    assert "counting" not in sys.modules
    for _ in range(2):
        names.entries("models")
        names.entries("problems")
    assert sys.modules["counting"].calls == [1]


def test_a_listing_imports_only_what_may_provide_its_kind(install, registry):
    install("only-models", MODEL.format(name="one"))
    install("by-star", "from only_models import *\nfrom only_models import termsel_models")
    names = registry()
    names.entries("solvers")
    assert [one.hooks for one in names._loader.plugins if one.distribution != "termsel"] \
        == [("termsel_models",), ()]
    assert [one.hooks for one in names.plugins if one.distribution != "termsel"] \
        == [("termsel_models",)] * 2


@pytest.mark.parametrize(("file", "content", "said"), [
    ("METADATA", None, "its METADATA is missing or cannot be read"),
    ("METADATA", bytes(range(256)), "its METADATA is missing or cannot be read"),
    ("entry_points.txt", bytes(range(256)), "its entry_points.txt cannot be read: Unicode"),
    ("entry_points.txt", b"[termsel]\nx = 1 + 1\n", "its entry_points.txt cannot be read")])
def test_unreadable_metadata_are_named(install, tmp_path, only, call, file, content, said):
    install("ruined-one", MODEL.format(name="x"))
    place = tmp_path / "ruined_one-1.0.dist-info"
    (place / file).unlink()
    if content is not None:
        (place / file).write_bytes(content)
    only("ruined-one")
    assert process_registry().names("models") == Registry([]).names("models")
    (ruined,) = json.loads(call("plugins", "--json").stdout)[1:]
    assert (ruined["distribution"], ruined["status"], ruined["requires"]) == (
        "ruined-one", "broken", "")
    assert said in ruined["reasons"][0]


@pytest.mark.parametrize(("required", "is_loaded"), [
    (">=0.2,<0.3", False), (f">={termsel.__version__},<0.4", True), ("~=0.2.1", False),
    ("[gis]>=0.3,<0.4", True), ("", True), (" @ https://example.org/termsel.whl", True)])
def test_a_plugin_for_another_version_is_refused_with_the_reason(
        install, registry, tmp_path, required, is_loaded):
    install("dated", MODEL.format(name="dated-model"))
    metadata = tmp_path / "dated-1.0.dist-info" / "METADATA"
    metadata.write_text(f"{metadata.read_text()}Requires-Dist: numpy>=1\n"
                        f"Requires-Dist: termsel{required}\n")
    names = registry()
    assert ("dated-model" in names.names("models")) == is_loaded
    assert ("dated" in sys.modules) == is_loaded
    reasons = [failure.what for failure in names.failures()]
    assert reasons == [] if is_loaded else reasons == [
        f"not loaded: it is for termsel{required}, and this is {termsel.__version__}; "
        "install a version of it for termsel 0.3"]


@pytest.mark.parametrize(("requirement", "version", "is_met"), [
    (">=0.3,<0.4", "0.3.0.dev0", True), (">=0.3.1", "0.3.0", False), ("==0.3", "0.3.0", True),
    ("==0.2.*", "0.3.0", False), ("!=0.3.*", "0.3.2", False), ("~=0.3.1", "0.3.4", True),
    ("~=0.3.1", "0.4.0", False), (">0.3", "0.3.0", False), ("<=0.3", "0.3.0", True)])
def test_requirements_of_versions(requirement, version, is_met):
    assert version_fits(requirement, version) == is_met


def test_get_takes_the_word_of_a_kind_and_names_the_kinds():
    assert termsel.get("solver", "ga") is termsel.get("solvers", "ga")
    with pytest.raises(TermselError, match=r"unknown kind 'sover'. Did you mean 'solver"):
        termsel.get("sover", "ga")


def test_a_run_of_built_in_things_imports_no_plugin(install, monkeypatch, tmp_path):
    hooks = "\n".join(f"@hookimpl\ndef termsel_{kind}(): return []" for kind in KINDS)
    install("slow", f"from termsel import hookimpl\n{hooks}\n")
    monkeypatch.setenv("TERMSEL_PLUGINS", "slow")
    process_registry.cache_clear()
    (tmp_path / "p.csv").write_text("id,role,line,sample,x,y,z\n" + "".join(
        f"p{i},,{i * i % 90},{i * 31 % 97},{i * i % 90 + 5},{i * 31 % 97 + 7},1\n"
        for i in range(25)))
    features = termsel.read(tmp_path / "p.csv", crs="local")
    termsel.run("poly-terms", features=features, solver="ga", generations=1,
                options={"population": 10, "polish": False})
    assert "slow" not in sys.modules
    process_registry().names("models")
    assert "slow" in sys.modules
    process_registry.cache_clear()


def test_the_traceback_of_a_plugin_is_shown_for_its_author(install, registry, capsys, monkeypatch):
    install("a-broken-one", "import no_such_module")
    monkeypatch.setenv("TERMSEL_DEBUG", "1")
    assert registry().failures()
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(("wanted", "expected"), [
    (None, ["termsel", "ant", "zebra-one"]), ("", ["termsel"]), (" , ", ["termsel"]),
    ("Zebra_One", ["termsel", "zebra-one"]), ("ant,zebra-one", ["termsel", "ant", "zebra-one"])])
def test_plugins_are_restricted_by_the_environment(install, monkeypatch, wanted, expected):
    install("zebra-one", MODEL.format(name="z"))
    install("ant", MODEL.format(name="a"))
    monkeypatch.setenv("TERMSEL_PLUGINS", wanted) if wanted is not None else \
        monkeypatch.delenv("TERMSEL_PLUGINS", raising=False)
    names = Registry()
    ours = {"termsel", "ant", "zebra-one"}
    assert [p.distribution for p in names.plugins if p.distribution in ours] == expected


def test_a_package_is_left_out_only_where_it_is_not_loaded(install, monkeypatch):
    for name in ("ant", "zebra-one", "wasp"):
        install(name, MODEL.format(name=name[0]))
    monkeypatch.setenv("TERMSEL_PLUGINS", " ant,Zebra_One")
    assert [is_left_out(name) for name in ("ant", "zebra-one", "wasp", "")] == [
        False, False, True, False]


def test_a_plugin_asked_for_and_not_installed_is_a_failure(monkeypatch):
    monkeypatch.setenv("TERMSEL_PLUGINS", "no-such-package")
    (failure,) = Registry().failures()
    assert failure.distribution == "no-such-package"
    assert "not installed" in failure.what


def test_unreadable_metadata_of_another_package_hides_no_plugin(install, tmp_path, monkeypatch):
    install("sound", MODEL.format(name="sound"))
    ruin = tmp_path / "aaa-1.0.dist-info"
    ruin.mkdir()
    (ruin / "entry_points.txt").write_text("[termsel]\nthis is no entry point\n")
    monkeypatch.setenv("TERMSEL_PLUGINS", "sound")
    assert "sound" in Registry().names("models")


def test_commands_replace_no_built_in_ones(install, registry):
    install("commander", """
        import click
        from termsel import hookimpl
        @hookimpl
        def termsel_commands(cli):
            @cli.command()
            def view(): '''Show a thing.'''
            @cli.command('list')
            def other(): '''Another list.'''
            raise RuntimeError('too late to take them back')""")
    names = registry()
    assert [(e.name, e.summary) for e in names.entries("commands")] == [
        ("view", "Show a thing."), ("commander:list", "Another list.")]
    assert [f.what.partition(":")[0] for f in names.failures()] == ["termsel_commands"] * 2


def test_public_names_can_be_imported():
    assert {"run", "Points", "__version__"} <= set(termsel.__all__) == set(dir(termsel))
    for name in termsel.__all__:
        assert getattr(termsel, name) is not None
    with pytest.raises(AttributeError, match="termsel has no 'nonsense'"):
        termsel.nonsense  # noqa: B018
