"""Run termsel as a process of its own: QGIS's Python has other versions of its libraries."""

import json
import os
import queue
import shutil
import signal
import subprocess  # nosec B404: termsel needs a Python of its own
import sys
import threading
import time
from pathlib import Path

from qgis.core import QgsApplication, QgsProcessingException, QgsSettings
from qgis.PyQt.QtCore import QCoreApplication, QThread

SETTING = "termsel/executable"
MISSING = ("termsel was not found: run the algorithm 'Set up termsel', or state the path of "
           "its command in the setting termsel/executable.")

_REMOVED = ("PYTHONHOME", "PYTHONPATH", "PYTHONEXECUTABLE", "PYTHONSTARTUP", "QT_PLUGIN_PATH",
            "QGIS_PREFIX_PATH", "LD_PRELOAD", "PIP_QUIET")
"""Variables that QGIS sets for its own Python and that would break another, and one that would
silence the messages of pip."""

# Seconds that a process has to end by itself, before it is killed.
_GRACE_SECONDS = 1.0
_WINDOWS = sys.platform == "win32"


def own_environment():
    """Return the folder of the environment that 'Set up termsel' makes, whether it exists or not.
    """
    return Path(QgsApplication.qgisSettingsDirPath()) / "termsel-environment"


def find_termsel_command():
    """Return the path of the command termsel.

    It is that of the setting, else that of the variable TERMSEL_EXECUTABLE, else that in the
    environment of 'Set up termsel', else that on PATH.

    Raises
    ------
    QgsProcessingException
        If there is none, or the setting or the variable names no file.
    """
    stated = QgsSettings().value(SETTING, "", type=str) or os.environ.get("TERMSEL_EXECUTABLE", "")
    if stated:
        path = Path(stated)
        # A folder is taken for a virtual environment.
        if path.is_dir():
            path = command_in(path)
        if not path.is_file():
            raise QgsProcessingException(
                f"The setting {SETTING} names {stated}, where there is no command termsel.")
        return str(path)
    own_command = command_in(own_environment())
    command = str(own_command) if own_command.is_file() else shutil.which("termsel")
    if not command:
        raise QgsProcessingException(MISSING)
    return command


def command_in(environment, name="termsel"):
    """Return the path that a command of this name has in a virtual environment, there or not."""
    suffix = ".exe" if _WINDOWS else ""
    return environment / ("Scripts" if _WINDOWS else "bin") / f"{name}{suffix}"


def clean_environment():
    """Return the environment variables for a process of termsel, as a new dict.

    Those of QGIS's own Python are left out; others make output plain, 100 columns wide and UTF-8.
    """
    variables = {name: value for name, value in os.environ.items() if name not in _REMOVED}
    variables["PYTHONIOENCODING"] = "utf-8"
    # With this, Python does not take modules from the folder that it is started in.
    variables["PYTHONSAFEPATH"] = "1"
    variables["NO_COLOR"] = "1"
    variables["COLUMNS"] = "100"
    return variables


def run(arguments, feedback, program=None, show=False):
    """Run a command to its end, show its messages and progress, and return its stdout.

    `arguments` are those of `program`, by default of termsel. With `show`, stdout is shown in the
    log, and "" is returned. Cancelling ends the process, and those it began, within two seconds.

    Raises
    ------
    QgsProcessingException
        If the command cannot be run, fails, or is cancelled; for one that fails with its message.
    """
    command = [program or find_termsel_command(), *map(str, arguments)]
    feedback.pushCommandInfo(" ".join(command))
    # Cancelling ends the group of the process, with the processes that the command began.
    options = ({"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
               if _WINDOWS else {"start_new_session": True})
    try:
        # No shell takes the list apart, and the program is that of the user's own settings.
        process = subprocess.Popen(  # nosec B603
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
            env=clean_environment(), encoding="utf-8", errors="replace", **options)
    except OSError as error:
        raise QgsProcessingException(f"{command[0]} cannot be run: {error.strerror}.") from error
    printed = []
    messages = queue.Queue()
    stdout = messages.put if show else printed.append
    # A thread reads each stream, as a full pipe would stop the command.
    readers = [threading.Thread(target=_read_lines, args=arguments_of_reader, daemon=True)
               for arguments_of_reader in ((process.stdout, stdout),
                                           (process.stderr, messages.put))]
    for reader in readers:
        reader.start()
    lines = []
    # Readers may still have lines when the process has ended.
    while process.poll() is None or any(reader.is_alive() for reader in readers):
        if feedback.isCanceled():
            _end_process_tree(process)
            _remove_leftovers(process.pid, command)
            raise QgsProcessingException("Cancelled; nothing was written.")
        _forward_messages(messages, feedback, lines)
        if QThread.currentThread() == QCoreApplication.instance().thread():
            # A batch runs in the thread of the window, whose button Cancel must work.
            QCoreApplication.processEvents()
        time.sleep(0.05)
    _forward_messages(messages, feedback, lines)
    if process.returncode:
        # The message begins at the first line with "Error:"; without one it is the last three.
        first = next((at for at, line in enumerate(lines) if line.startswith("Error:")), -3)
        raise QgsProcessingException(" ".join(lines[first:]) or f"{command[0]} ended with code "
                                     f"{process.returncode}.")
    return "".join(printed)


def _read_lines(stream, take):
    """Call `take` with each line of a stream as it comes, and close the stream at its end."""
    with stream:
        for line in stream:
            take(line)


def _forward_messages(messages, feedback, lines):
    """Take the waiting messages from a queue: show progress in the bar, and others in the log.

    The others are appended to `lines` too. An error is not shown in the log, as the exception that
    follows has it.
    """
    while not messages.empty():
        line = messages.get().rstrip()
        # --progress json writes such lines.
        if line.startswith('{"progress"'):
            step = json.loads(line)
            if step["progress"] is not None:
                feedback.setProgress(100 * step["progress"])
            feedback.setProgressText(" ".join(filter(None, (step["what"], step["state"]))))
        elif line:
            lines.append(line)
            if line.startswith("Error:"):
                continue
            if line.startswith(("Warning", "Note")):
                feedback.pushWarning(line)
            else:
                feedback.pushInfo(line)


def _remove_leftovers(number, command):
    """Remove the hidden folders in which a process that was killed had begun to write.

    `number` is that of the process. The hidden folders are beside the files that it writes, so
    those of all arguments of `command` are searched.
    """
    for folder in {Path(argument).absolute().parent for argument in command[1:]}:
        for leftover in folder.glob(f".termsel-*-{number}-*"):
            shutil.rmtree(leftover, ignore_errors=True)


def _end_process_tree(process):
    """End a process and those that it began.

    On Windows they are killed. Elsewhere they get the signal of Ctrl-C, so that termsel can remove
    what it has begun, and are killed if they do not end within `_GRACE_SECONDS`.
    """
    if _WINDOWS:
        taskkill = Path(os.environ["SYSTEMROOT"]) / "System32" / "taskkill.exe"
        subprocess.run(  # nosec B603: of Windows itself
            [str(taskkill), "/F", "/T", "/PID", str(process.pid)], check=False, capture_output=True)
        return
    os.killpg(process.pid, signal.SIGINT)
    try:
        process.wait(_GRACE_SECONDS)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
