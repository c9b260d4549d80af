"""The registry: built-ins through hooks, third parties in isolation."""

import inspect
import json
import os
import re
import sys
import warnings
from importlib.metadata import distributions
from textwrap import dedent

import pytest

import termsel
from termsel.errors import TermselError
from termsel.plugins import builtin, hookspecs, loading
from termsel.plugins.kinds import KINDS
from termsel.plugins.loading import HOOKS
from termsel.plugins.registry import Registry
from termsel.plugins.registry import registry as process_registry

BUILT_IN = {
    "problems": {"rfm-terms", "rfm-terms-lines", "poly-terms", "owdis-points", "owdis-lines",
                 "owdis-points-terms", "owdis-lines-terms"},
    "models": {"rfm", "poly2d", "poly3d", "affine"},
    "solvers": {"ga", "swap", "random", "all-terms"},
    "criteria": {"check-rmse"},
    "datasets": {"ikonos-hamedan", "spot-isfahan", "irs1c-mashad"},
    "readers": {"points-csv", "lines-csv"},
}

MODEL = """
    import numpy as np
    from termsel import Blocks, RationalModel, hookimpl

    class DLT(RationalModel):
        '''Direct linear transformation: one shared denominator, 11 terms.'''
        name = {name!r}
        def blocks(self, ground):
            one = np.column_stack([np.ones(len(ground)), ground])
            return Blocks(line=one, sample=one, shared_denominator=ground)

    @hookimpl
    def termsel_models():
        return [DLT]
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that installs a plugin package in a folder of its own."""
    monkeypatch.syspath_prepend(tmp_path)

    def package(distribution, code, name=None, version="1.0"):
        module = distribution.replace("-", "_")
        monkeypatch.delitem(sys.modules, module, raising=False)
        (tmp_path / f"{module}.py").write_text(dedent(code))
        info = tmp_path / f"{module}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(
            f"[termsel]\n{name or module} = {module}\n")

    return package


@pytest.fixture
def registry(tmp_path):
    """Return a function that makes a registry of what was installed."""
    return lambda: Registry(
        [point for found in distributions(path=[str(tmp_path)]) for point in found.entry_points])


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
    assert [(part.place, part.value) for part in known.parts()] == [("study", 1), ("scheduler", 2)]
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


BROKEN = {
    "missing import": ("import no_such_module", "No module named 'no_such_module'"),
    "syntax error": ("def x(:", "SyntaxError"),
    "leaves the program": ("import sys; sys.exit(3)", "SystemExit"),
    "no hooks": ("def termsel_models(): return []", "no hooks"),
    "wrong argument": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(scene): return []""", "scene"),
    "unknown hook": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_modells(): return []""", "Did you mean 'termsel_models'?"),
    "raises": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): return 1 / 0""", "termsel_models: ZeroDivisionError"),
    "raises on the way": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models():
            raise ValueError("late")
            yield""", "termsel_models: ValueError: late"),
    "returns nothing": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): pass""", "returned None, not a list"),
    "returns text": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_solvers(): return 'ga'""", "returned 'ga', not a list"),
    "returns a class itself": ("""
        from termsel import SensorModel, hookimpl
        @hookimpl
        def termsel_models(): return SensorModel""", "not a list"),
    "of another kind": ("""
        from termsel import Solver, hookimpl
        class Mine(Solver):
            name = 'mine'
            def generations(self, problem, rng): yield
        @hookimpl
        def termsel_models(): return [Mine]""", "the class Mine, not a subclass of SensorModel"),
    "attribute of another type": ("""
        from termsel import Affine, hookimpl
        class Mine(Affine):
            name = 'mine'
            uses_height = 'no'
        @hookimpl
        def termsel_models(): return [Mine]""", "Mine with uses_height = 'no', which is no bool"),
    "options that are none": ("""
        from termsel import Affine, hookimpl
        class Mine(Affine):
            name = 'mine'
            declared_options = ({'name': 'degree'},)
        @hookimpl
        def termsel_models(): return [Mine]""",
        "Mine with declared_options that hold {'name': 'degree'}, which is no Option"),
    "option of no type": ("""
        from termsel import Affine, Option, hookimpl
        class Mine(Affine):
            declared_options = (Option('degree', 2, 'Degree.', list),)""",
        "option 'degree' has the type <class 'list'>"),
    "instance for a class": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): return [42]""", "of type int, not a subclass of SensorModel"),
    "instance of another kind": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_problems(): return [{'name': 'x'}]""", "type dict, not an instance of Recipe"),
    "class for an instance": ("""
        from termsel import Recipe, hookimpl
        @hookimpl
        def termsel_problems(): return [Recipe]""", "class Recipe, not an instance of Recipe"),
    "class that needs arguments": ("""
        from termsel import Reader, hookimpl
        class Table(Reader):
            name, summary = 'table', 'points'
            def __init__(self, mark): super().__init__()
            def sniff(self, path, head): return False
            def read(self, path): raise AssertionError
        @hookimpl
        def termsel_readers(): return [Table]""", "argument: 'mark'"),
    "methods missing": ("""
        from termsel import RationalModel, hookimpl
        class Half(RationalModel):
            name = 'half'
        @hookimpl
        def termsel_models(): return [Half]""", "the class Half, which lacks blocks"),
    "no name": ("""
        from termsel import Blocks, RationalModel, hookimpl
        class Nameless(RationalModel):
            def blocks(self, ground): return Blocks(ground, ground)
        @hookimpl
        def termsel_models(): return [Nameless]""", "Nameless with the name None"),
    "impossible name": ("""
        from termsel import Blocks, RationalModel, hookimpl
        class Odd(RationalModel):
            name = 'a b'
            def blocks(self, ground): return Blocks(ground, ground)
        @hookimpl
        def termsel_models(): return [Odd]""", "the name 'a b'"),
    "leaves by an exception of its own": ("""
        class Away(BaseException): pass
        raise Away('far')""", "cannot be imported: Away: far"),
    "leaves by an exception without a message": ("""
        class Away(BaseException):
            def __str__(self): raise ValueError
        raise Away""", "cannot be imported: Away: <exception str() failed>"),
    "leaves as if interrupted": ("raise KeyboardInterrupt", "imported: KeyboardInterrupt"),
    "leaves as if closed": ("raise GeneratorExit", "cannot be imported: GeneratorExit"),
    "hook that leaves as if interrupted": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): raise KeyboardInterrupt""", "termsel_models: KeyboardInterrupt"),
    "hook that leaves": ("""
        from termsel import hookimpl
        class Away(BaseException): pass
        @hookimpl
        def termsel_models(): raise Away('far')""", "termsel_models: Away: far"),
    "command raises": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_commands(cli): cli.add_command('view')""", "termsel_commands: AttributeError"),
}


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
    assert names.get("models", "rfm").__module__ == "termsel.models.rational"
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


INSTANCE = """
    from termsel import Criterion, hookimpl

    class Quantile(Criterion):
        '''A quantile of the check errors [px].'''
        name = 'quantile'
        def score(self, fits): return abs(fits.check_errors).max(axis=(1, 2))

    @hookimpl
    def termsel_criteria(): return [Quantile()]
    """


def test_an_instance_where_a_class_is_wanted_is_refused(install, registry):
    install("old-rule", INSTANCE)
    names = registry()
    assert [failure.what for failure in names.failures()] == [
        "termsel_criteria: TypeError: returned an object of type Quantile, not a subclass of "
        "Criterion; return the class"]
    assert "quantile" not in names.names("criteria")
    module = sys.modules["old_rule"]
    assert isinstance(names.taken("criteria", module.Quantile()), module.Quantile)
    with pytest.raises(TermselError, match="nothing that termsel has names for"):
        names.register(module.Quantile())


@pytest.fixture
def only(monkeypatch):
    """Return a function that makes one package the only plugin of this process, for a while."""
    def restrict(distribution):
        monkeypatch.setenv("TERMSEL_PLUGINS", distribution)
        process_registry.cache_clear()

    yield restrict
    process_registry.cache_clear()


def test_slow_imports_are_named(install, only, call):
    code = MODEL.format(name="m").replace("\n    ", "\n")
    install("slow-one", f"import time; time.sleep(0.35){code}")
    only("slow-one")
    shown = call("plugins", "--time").stdout
    assert re.search(r"Slow: plugin 'slow_one' of slow-one 1\.0 takes \d+\.\d s\.", shown)
    assert "Slow: plugin 'builtin'" not in shown
    found = json.loads(call("plugins", "--time", "--json").stdout)
    assert [one["seconds"] > 0.3 for one in found[1:]] == [True]
    assert "seconds" not in json.loads(call("plugins", "--json").stdout)[1]


NEW_RULE = {
    "models": MODEL.format(name="new"),
    "solvers": """
        from termsel import Generation, Solver, hookimpl
        class New(Solver):
            name = 'new'
            def generations(self, problem, rng): yield
        @hookimpl
        def termsel_solvers(): return [New]""",
    "criteria": """
        from termsel import Criterion, hookimpl
        class New(Criterion):
            name = 'new'
            def score(self, fits): return abs(fits.check_errors).max(axis=(1, 2))
        @hookimpl
        def termsel_criteria(): return [New]""",
    "readers": """
        from termsel import Reader, hookimpl
        class New(Reader):
            name, summary = 'new', 'points'
            def sniff(self, path, head): return False
            def read(self, path): raise AssertionError
        @hookimpl
        def termsel_readers(): return [New]""",
    "writers": """
        from termsel import Writer, hookimpl
        class New(Writer):
            name, summary = 'new', 'points'
            def accepts(self, result): return False
            def write(self, result, path): raise AssertionError
        @hookimpl
        def termsel_writers(): return [New]""",
}


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
        kind not in ("problems", "objectives", "candidates", "datasets", "splits"))
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


WRAPPERS = """
    from termsel import hookimpl, Affine
    class Last(Affine):
        '''An affine model.'''
        name = {name!r}
    @hookimpl({how})
    def termsel_models():
        {body}
"""


def test_pluggy_orders_and_wraps_the_calls(install, registry):
    install("ant", WRAPPERS.format(name="late", how="trylast=True", body="return [Last]"))
    install("bee", WRAPPERS.format(name="early", how="tryfirst=True", body="return [Last]"))
    install("cat", WRAPPERS.format(name="own", how="wrapper=True", body="""
        lists = yield
        return [[m for m in one if m.name != 'affine'] for one in lists] + [[Last]]"""))
    install("dog", WRAPPERS.format(name="x", how="hookwrapper=True", body="""
        result = yield
        result.force_result([[m for m in one if m.name != 'poly3d']
                             for one in result.get_result()])"""))
    names = registry()
    assert not names.failures("models")
    found = names.names("models")
    assert found[0] == "early"
    assert found[-2:] == ["late", "own"]
    assert "rfm" in found
    assert not {"affine", "poly3d"} & set(found)
    assert names.origin(names.get("models", "own")).provided_by == "cat"


@pytest.mark.parametrize(("how", "body", "reason"), [
    ("wrapper=True", "raise OSError('before')\n        yield", "as a wrapper: OSError: before"),
    ("wrapper=True", "yield\n        raise OSError('after')", "as a wrapper: OSError: after"),
    ("wrapper=True", "yield\n        return 5", "as a wrapper: TypeError: returned 5, not a list"),
    ("wrapper=True", "yield", "as a wrapper: TypeError: returned nothing; a wrapper returns"),
    ("hookwrapper=True", "r = yield\n        r.force_result(None)",
     "as a wrapper: TypeError: returned nothing"),
    ("wrapper=True", "yield\n        yield", "as a wrapper: RuntimeError: it yields twice"),
    ("hookwrapper=True", "r = yield\n        r.force_result('no')",
     "as a wrapper: TypeError: returned 'no', not a list"),
    ("wrapper=True", "if 0: yield\n        return []", "as a wrapper: StopIteration"),
    ("", "while True: yield Last", "returned more than 10,000 things; the list must end")])
def test_a_broken_wrapper_or_endless_hook_changes_nothing(install, registry, how, body, reason):
    install("wrapping", WRAPPERS.format(name="x", how=how, body=body))
    names = registry()
    assert names.names("models") == Registry([]).names("models")
    assert reason in names.failures()[0].what


def test_the_first_called_takes_no_name_of_termsel(install, registry):
    install("rival", WRAPPERS.format(name="rfm", how="tryfirst=True", body="return [Last]"))
    names = registry()
    assert names.get("models", "rfm").__module__ == "termsel.models.rational"
    assert names.names("models")[0] == "rival:rfm"


def test_every_listener_has_a_copy(install, registry, tmp_path):
    install("a-changer", f"""
        import os, sys, warnings
        from termsel import hookimpl
        @hookimpl
        def termsel_run_finished(result):
            result['a'].append(1)
            os.chdir({str(tmp_path)!r})
            warnings.simplefilter('error')
            sys.exit(3)""")
    install("b-listener", """
        from termsel import hookimpl
        heard = []
        @hookimpl
        def termsel_run_finished(result): heard.append(result)""")
    before = os.getcwd(), list(warnings.filters)
    given = {"a": []}
    registry().notify_run_finished(given)
    assert given == sys.modules["b_listener"].heard[0] == {"a": []}
    assert sys.modules["b_listener"].heard[0] is not given
    # Files of the result are still written here, and warnings of termsel are no errors.
    assert (os.getcwd(), list(warnings.filters)) == before


ENDLESS = {
    "import": ("import time\nwhile True: time.sleep(0.01)\n", "cannot be imported"),
    "hook": ("""
        import time
        from termsel import hookimpl
        @hookimpl
        def termsel_models():
            while True: time.sleep(0.01)""", "termsel_models"),
    "wrapper": ("""
        import time
        from termsel import hookimpl
        @hookimpl(wrapper=True)
        def termsel_models():
            lists = yield
            while True: time.sleep(0.01)""", "termsel_models: as a wrapper"),
}


@pytest.mark.parametrize("kind", ENDLESS)
def test_an_endless_import_or_hook_is_left_out(install, registry, monkeypatch, caplog, kind):
    code, where = ENDLESS[kind]
    monkeypatch.setattr(loading, "LIMIT", 0.5)
    monkeypatch.setattr(loading, "SOON", 0.2)
    install(f"a-endless-{kind}", code)  # a module that is being imported keeps its lock
    install("b-sound-one", MODEL.format(name="sound"))
    names = registry()
    assert names.names("models") == [*Registry([]).names("models"), "sound"]
    assert names.failures("models")[0].what == f"{where}: it takes more than 0.5 s"
    assert f"or a hook of a-endless-{kind} 1.0 is taking long. Ctrl-C ends" in caplog.text


def test_what_took_too_long_once_is_not_asked_again(install, registry, monkeypatch):
    monkeypatch.setattr(loading, "LIMIT", 0.5)
    install("stuck", """
        import time
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): time.sleep(60)
        @hookimpl
        def termsel_solvers(): raise AssertionError""")
    names = registry()
    names.names("models")
    assert names.names("solvers") == Registry([]).names("solvers")
    assert "not asked, as it took too long" in names.failures("solvers")[0].what


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


def test_only_a_module_that_names_the_listener_is_asked_after_a_run(install, registry):
    install("a-listener", """
        from termsel import hookimpl
        heard = []
        @hookimpl
        def termsel_run_finished(result): heard.append(result)""")
    install("b-silent", "costs = 'every run'")
    names = registry()
    names.notify_run_finished("result")
    assert sys.modules["a_listener"].heard == ["result"]
    assert "b_silent" not in sys.modules
    assert "no hooks" in names.failures("models")[0].what
    assert "b_silent" in sys.modules


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


def test_every_plugin_hears_of_a_finished_run(install, registry, capsys):
    install("a-deaf-one", """
        from termsel import hookimpl
        @hookimpl
        def termsel_run_finished(result): raise OSError('disk full')""")
    install("b-listener", """
        from termsel import hookimpl
        heard = []
        @hookimpl
        def termsel_run_finished(result): heard.append(result)""")
    names = registry()
    names.notify_run_finished("the result")
    assert sys.modules["b_listener"].heard == ["the result"]
    captured = capsys.readouterr()
    assert "a-deaf-one 1.0: termsel_run_finished: OSError: disk full" in captured.err
    assert captured.out == ""


def test_a_hook_may_leave_out_its_argument(install, registry):
    install("brief", """
        from termsel import hookimpl
        heard = []
        @hookimpl
        def termsel_run_finished(): heard.append(1)""")
    registry().notify_run_finished("the result")
    assert sys.modules["brief"].heard == [1]


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
    with pytest.raises(AttributeError, match="attribute nonsense"):
        termsel.nonsense  # noqa: B018


def test_observers_of_plugins_hear_of_every_run_until_they_fail(install, registry, monkeypatch,
                                                                 capsys):
    install("a-listener", """
        from termsel import hookimpl
        heard, failed = [], []
        def fails(progress):
            failed.append(1)
            raise KeyError("mine")
        @hookimpl
        def termsel_observers(): return [lambda progress: heard.append(progress), fails]""")
    monkeypatch.setattr("termsel.runs.run.registry", registry)
    result = termsel.run("poly-terms", evaluations=60, options={"degree": 1, "population": 20})
    module = sys.modules["a_listener"]
    assert [one.evaluations for one in module.heard] == sorted(
        one.evaluations for one in module.heard)
    assert module.heard[-1].evaluations == result.evaluations
    assert module.failed == [1]
    assert capsys.readouterr().err.count("an observer failed: KeyError: 'mine'") == 1
