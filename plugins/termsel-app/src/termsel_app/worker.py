"""The process in which the control is judged: a newer change supersedes an older one."""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from multiprocessing.connection import Connection
from threading import Thread
from typing import TYPE_CHECKING, Any

from termsel import allow_driver, allow_remote
from termsel.toolkit import safe_start

if TYPE_CHECKING:
    from termsel_app.quality import Answer, Question


def answer_questions(questions: Connection, remote: bool, drivers: Sequence[str]) -> None:
    """Answer questions that come through a pipe, until None comes or the pipe is closed.

    The answers to a question end when the next one is there. `remote` is whether servers may be
    asked, `drivers` names further drivers of GDAL that are allowed. It runs in its own process.
    """
    from termsel import Memory
    from termsel_app.quality import import_engine, judge_control

    # Ctrl-C ends the server, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.getLogger("termsel").setLevel(logging.ERROR)
    with ExitStack() as stack:
        if remote:
            stack.enter_context(allow_remote())
        stack.enter_context(allow_driver(*drivers))
        import_engine()
        memory = Memory()
        try:
            while (question := _wait_for_newest_question(questions)) is not None:
                for answer in judge_control(question, memory):
                    questions.send(answer)
                    if questions.poll():
                        break
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def _wait_for_newest_question(questions: Connection) -> Question | None:
    """Wait for a question, and return the newest of those that have come; None to end the process.
    """
    question: Question | None = questions.recv()
    while questions.poll():
        question = questions.recv()
    return question


class Worker:
    """A process that judges control; one that died is started again with the next question.

    Parameters
    ----------
    remote : bool
        Whether servers may be asked.
    drivers : sequence of str
        Names of further drivers of GDAL that are allowed.

    Attributes
    ----------
    tell : callable
        Called, in a thread of the worker, with each answer.
    """

    def __init__(self, remote: bool = False, drivers: Sequence[str] = ()) -> None:
        self.tell: Callable[[Answer], None] = lambda _: None
        self._access = (remote, tuple(drivers))
        self._process: Any = None
        self._pipe: Connection | None = None
        self._begin()

    def ask(self, question: Question) -> None:
        """Send a question, whose answers come by calls of `tell`; an earlier one is given up."""
        if self._process is None or not self._process.is_alive():
            self._begin()
        assert self._pipe is not None
        self._pipe.send(question)

    def close(self) -> None:
        """Kill the process, and wait for its end."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def _begin(self) -> None:
        """Start the process that computes answers, and the thread that hands them to `tell`."""
        # "spawn" begins a new interpreter: a fork would copy locks that other threads hold.
        context = multiprocessing.get_context("spawn")
        # It is a process, as a fit in a thread would keep the interpreter from answering the page.
        own_end, their_end = context.Pipe()
        with safe_start():
            self._process = context.Process(
                target=answer_questions, args=(their_end, *self._access), daemon=True)
            self._process.start()
        their_end.close()
        self._pipe = own_end
        Thread(target=self._listen, args=(own_end,), daemon=True).start()

    def _listen(self, pipe: Connection) -> None:
        """Call `tell` with the answers of the process, until it ends.

        If it ends while it is the process in use, `tell` gets a refusal with the serial -1.
        """
        while True:
            try:
                answer = pipe.recv()
            except (EOFError, OSError):
                if self._process is not None and pipe is self._pipe:
                    self.tell({"serial": -1, "stage": "refused", "ids": [],
                               "text": "The process that computes has ended.",
                               "hint": "The next change starts it again."})
                return
            self.tell(answer)
