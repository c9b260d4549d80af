"""Methods that need more of a task than its features: its problem, and roles of their own."""

from __future__ import annotations

from abc import abstractmethod

from termsel.auto.memory import Memory
from termsel.fitting.method import Method
from termsel.runs.finding import Finding
from termsel.runs.request import Request
from termsel.runs.task import Task


class TaskMethod(Method):
    """A method whose fit judges by selection points, so that roles are part of what it is given."""

    @abstractmethod
    def find(self, task: Task, memory: Memory) -> tuple[Request, Finding]:
        """Return the request and the finding on the features of a prepared task.

        Parameters
        ----------
        task : Task
            What is to be solved, with its features and their roles.
        memory : Memory
            What was found of the same features before.

        Returns
        -------
        Request
            What was asked for: that of `task`, or of the task that the method prepared from the
            features of `task`.
        Finding
            What the method found.
        """
