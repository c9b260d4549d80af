"""How hooks of plugins are called: their order, wrappers, arguments and listeners."""

import os
import sys
import warnings

import pytest

import termsel
from termsel.plugins.registry import Registry
from tests.plugin_texts import WRAPPERS


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
    assert names.get("models", "rfm").__module__ == "termsel.models.quotient"
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
