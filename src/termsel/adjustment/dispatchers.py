"""How functions are compiled, by numba; `compiled` says when."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from io import FileIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

from termsel.adjustment.numba_settings import import_numba
from termsel.core.errors import TermselError
from termsel.core.files.lock import end_turn, take_turn

import_numba()

import numba  # noqa: E402
from numba.core import types  # noqa: E402
from numba.core.caching import FunctionCache  # noqa: E402
from numba.core.compiler_lock import global_compiler_lock  # noqa: E402
from numba.core.registry import cpu_target  # noqa: E402
from numba.core.runtime import rtsys  # noqa: E402

log = logging.getLogger(__name__)

_UNREADABLE = (EOFError, UnpicklingError, OSError, AttributeError, ImportError)
"""What reading kept code raises that is damaged, or is of a version with other names."""


LEVEL = 1
"""Optimisation by LLVM, of 3, which numba asks for: kernels are as fast, and compiled in half the
time."""

PATIENCE = 60.0
"""Seconds for which a process waits for another one that compiles the same."""


class _Cache(FunctionCache):
    """Machine code on disk that is compiled again if it is damaged, and need not be kept."""

    _turn: FileIO | None = None  # while this process compiles
    _waits = True  # until another process took too long, or nothing could be locked

    def __init__(self, function: Callable[..., Any], flags: dict[str, Any]) -> None:
        self._inner = "no_cpython_wrapper" in flags  # of kernels: Python cannot call it
        self._allocates = flags.get("_nrt", True)
        super().__init__(function)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        # With and without the wrapper for Python are two kinds of code of one function.
        return *super()._index_key(sig, codegen), self._inner

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code kept for a signature; None if this process has to compile it.

        While another process compiles the same kernel, its code is waited for, `PATIENCE` at most.
        """
        code = self._read(sig, target_context)
        if code is None and self._turn is None and _Cache._waits:
            lock_file = Path(self._cache_file._index_path).with_suffix(".lock")
            self._turn = take_turn(lock_file, PATIENCE)
            # A process that waited in vain does not wait for each further kernel.
            _Cache._waits = self._turn is not None
            code = self._read(sig, target_context)  # of another process, which compiled meanwhile
        return code

    def end(self) -> None:
        """Let another process compile."""
        if self._turn is not None:
            end_turn(self._turn)
            self._turn = None

    def _read(self, sig: Any, target_context: Any) -> Any:
        """Return the code kept, None if there is none; code that cannot be read is removed."""
        try:
            # Not super().load_overload, which first makes the compiler ready and takes 0.2 s.
            # Loading needs only the runtime that arrays are allocated by, and that where kernels
            # allocate any.
            if self._allocates:
                rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except _UNREADABLE:
            self._forget()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code if the disk takes it."""
        try:
            super().save_overload(sig, data)
        except _UNREADABLE as error:
            log.info("The compiled code cannot be kept: %s", error)

    def has_code(self) -> bool:
        """Return whether code of this very source, compiled by this numba, is kept."""
        try:
            return any(key[-1] == self._inner for key in self._cache_file._load_index())
        except _UNREADABLE:  # it will be compiled again
            return False

    def _forget(self) -> None:
        """Remove the code kept, or log that this failed."""
        try:
            self.flush()
        except OSError as error:
            log.info("The compiled code cannot be kept: %s", error)


def type_of(dispatcher: Any) -> types.Type:
    """Return the type of a dispatcher or an intrinsic in kernels that use it."""
    typing_context = cpu_target.typing_context
    typing_context.refresh()
    return typing_context.resolve_value_type(dispatcher)


def dispatcher_of(function: Callable[..., Any], flags: dict[str, Any]) -> Any:
    """Return numba's dispatcher of a function, which compiles it for the types of each call.

    Flags are those of `compiled`. Raises TermselError where numba is told to compile nothing.
    """
    if numba.config.DISABLE_JIT:  # which intrinsics of the kernels cannot do
        raise TermselError("NUMBA_DISABLE_JIT is set, and termsel cannot compute without compiled "
                           "code", hint="Unset NUMBA_DISABLE_JIT, then repeat the command.")
    dispatcher = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True,
                            **flags)(function)
    # No kernel needs what other packages add to numba, which takes long to look for.
    dispatcher._compilation_chain_init_hook = lambda: None
    template_of = dispatcher.get_call_template

    def template_of_plain_types(args: Iterable[Any], keywords: Mapping[str, Any]) -> Any:
        """Return the template of a call in which a constant counts as any integer.

        Else a counter that begins with a constant would have its callee compiled for that constant,
        too.
        """
        plain_keywords = {name: types.unliteral(type_) for name, type_ in keywords.items()}
        return template_of(tuple(map(types.unliteral, args)), plain_keywords)

    dispatcher.get_call_template = template_of_plain_types
    compile_signature = dispatcher.compile
    code_cache = None
    try:
        code_cache = dispatcher._cache = _Cache(function, flags)  # as numba does for cache=True
    except RuntimeError:  # numba finds no folder that it can write to
        _say_that_nothing_is_kept()

    def compile_locked(signature: Any) -> Any:
        """Compile for a signature, at this level of optimisation, then let others go on."""
        with global_compiler_lock:  # as numba does: settings are those of all threads
            requested_level = numba.config.OPT
            # The level keeps its type, by which numba shows what the user set.
            numba.config.OPT = type(requested_level)(min(requested_level, LEVEL))
            try:
                return compile_signature(signature)
            finally:  # also of what cannot be compiled, or was interrupted
                numba.config.OPT = requested_level
                if code_cache:
                    code_cache.end()

    # Numba calls both by these names, for a call from Python as well as from other kernels.
    dispatcher.compile = compile_locked
    return dispatcher


def has_code(dispatcher: Any) -> bool:
    """Return whether a dispatcher can be called at once."""
    code_cache = dispatcher._cache
    return bool(dispatcher.signatures) or (isinstance(code_cache, _Cache) and code_cache.has_code())


@cache  # said once for each process
def _say_that_nothing_is_kept() -> None:
    """Tell the user, once."""
    log.warning("Note: compiled code cannot be kept here. Every run takes some 5 s longer. "
                "Set NUMBA_CACHE_DIR to a folder that you can write to.")
