"""Faults that tests give to things, and what is said of them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest

from termsel.core.errors import TermselError
from termsel.core.isolation.faults import PluginFault


def raising(*_args: Any, **_given: Any) -> Any:
    raise ValueError("of the plugin")


def leaving(*_args: Any, **_given: Any) -> Any:
    sys.exit(3)


def always(value: Any) -> Callable[..., Any]:
    return lambda *_args, **_given: value


def altered(base: type, method: str, fault: Any, name: str = "faulty") -> Any:
    return type("Faulty", (base,), {"name": name, method: fault, "__module__": __name__,
                                    "__doc__": "Differs in one way."})


def told_of(fault: pytest.ExceptionInfo[TermselError], message: str, thing: str = "") -> None:
    assert message in str(fault.value)
    if isinstance(fault.value, PluginFault):
        assert thing in fault.value.what
        assert "of the module tests" in fault.value.what
        assert "report it to its author" in str(fault.value.hint)
