"""Plugins that take long, or never end."""

import json
import re

import pytest

from termsel.plugins import loading
from termsel.plugins.registry import Registry
from tests.plugin_texts import ENDLESS, MODEL


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
    assert f"loading the package a-endless-{kind} 1.0 has taken 0.2 s so far" in caplog.text


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
    assert "not called, as it took too long" in names.failures("solvers")[0].what
