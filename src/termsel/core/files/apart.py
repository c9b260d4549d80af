"""Files read in a process of its own, whose memory and time have limits.

Some libraries believe a small file that says it holds billions of cells, and a vector file may have
a query without end. In the other process such a file ends that process alone. Its GDAL has only the
drivers of `termsel.core.files.drivers`, whatever the program that imported termsel uses GDAL for.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from termsel.core.errors import TermselError
from termsel.core.files.drivers import (
    allow_driver,
    allow_remote,
    allowed_drivers,
    program_environment,
    remote_allowed,
)
from termsel.core.files.names import require_regular
from termsel.core.isolation.helper import Helper, ProcessEndedError

_SERVE_VECTORS = "from termsel.core.files.apart import serve; serve()"

_MEMORY = 600 << 20
"""Bytes for a small file."""
_MEMORY_A_BYTE = 60
_SECONDS = 3.0
"""CPU time for a small file."""
_SECONDS_A_BYTE = 2e-6

Answer = TypeVar("Answer")

HELPERS: list[Helper] = []
"""Processes that were started."""

_too_much: dict[tuple[object, ...], TermselError] = {}
"""Files, as they were, that took too much."""


def call_apart(work: Callable[..., Answer], path: Path, *arguments: Any) -> Answer:
    """Return the value of a function, called in another process with a file and further values.

    Raises
    ------
    TermselError
        Where the function raises it; if the file is no regular one, or if the call takes more
        memory or time than a file of that size should.
    """
    require_regular(path)
    state = path.stat() if path.is_file() else None
    size = 0 if state is None else state.st_size
    # Tables unpack to at most some sixty bytes of memory a byte; a file that takes more says
    # something false of itself.
    memory = _MEMORY + _MEMORY_A_BYTE * size
    seconds = _SECONDS + _SECONDS_A_BYTE * size
    helper = _vector_helper(allowed_drivers(), remote_allowed())
    question = (work.__module__, work.__name__, (path, *arguments), memory, seconds)
    # Several readers look at a file before one reads it: what was too much once is not tried again.
    file_state = (str(path.absolute()), size, state and state.st_mtime_ns)
    if file_state in _too_much:
        raise _too_much[file_state]
    try:
        # The limit is one of processor time; on a busy machine that takes longer.
        answer = helper.ask(question, 10 * seconds)
    except ProcessEndedError:
        answer = MemoryError()
    if isinstance(answer, MemoryError):
        error = TermselError(
            f"reading this file takes more than {memory >> 20:,} MiB of memory or {seconds:.0f} s, "
            f"which no file of {size / 1024:,.0f} KiB should", file=path,
            hint="Save its table or layer alone, without blank cells and without queries, "
                 "with the program that wrote it.")
        _too_much[file_state] = error
        raise error
    if isinstance(answer, TermselError):
        raise answer
    return answer  # type: ignore[no-any-return]


@cache  # one process for each set of drivers, ended with this one
def _vector_helper(drivers: tuple[str, ...], remote: bool) -> Helper:
    """Return the process that reads vector files with such drivers, started once."""
    with ExitStack() as stack:
        if remote:
            stack.enter_context(allow_remote())
        helper = Helper(f"{_SERVE_VECTORS.removesuffix('()')}({drivers!r}, {remote!r})",
                        program_environment(os.environ))
    atexit.register(helper.end)
    HELPERS.append(helper)
    return helper


@contextmanager
def answer_channel(drivers: tuple[str, ...], remote: bool) -> Iterator[BinaryIO]:
    """Yield the file to which a new process writes its answers, in place of stdout.

    In the block GDAL may use the `drivers`, and read from servers if `remote`. Ctrl-C is left to
    the process that asks.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with os.fdopen(os.dup(1), "wb") as answers, ExitStack() as stack:
        # What libraries print, even as they end, is no answer, and of no use to the user.
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        stack.enter_context(allow_driver(*drivers))
        if remote:
            stack.enter_context(allow_remote())
        yield answers


def serve(drivers: tuple[str, ...] = (), remote: bool = False) -> None:
    """Answer the questions that come on stdin, in a new process.

    It runs until stdin ends. Each question has a function by name, its arguments, and limits of
    memory and time, so that a hostile file ends this process and not the program. An answer is the
    value of the function, or the TermselError or MemoryError that it raised; any other exception
    ends the process.
    """
    with answer_channel(drivers, remote) as answers:
        while True:
            try:
                module, name, values, memory, seconds = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            work = getattr(import_module(module), name)
            answer: Any
            try:
                _limit_process(memory, seconds)
                answer = work(*values)
            except (TermselError, MemoryError) as error:
                answer = error
            pickle.dump(answer, answers)
            answers.flush()


def _limit_process(memory: int, seconds: float) -> None:
    """Limit the further memory [bytes] and CPU time [s] of this process; only on Linux."""
    if sys.platform != "linux":
        return
    import resource

    # The limit is on addresses, of which the process has some already: pages of /proc/self/statm.
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    address_space = pages * resource.getpagesize() + memory
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        address_space = min(address_space, hard)
    resource.setrlimit(resource.RLIMIT_AS, (address_space, hard))
    # The limit of CPU time counts from the start of the process, not from now.
    usage = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    limit = int(usage.ru_utime + usage.ru_stime + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU,
                       (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
