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

    It is the one that the setting states, else that of the variable TERMSEL_EXECUTABLE, else that
    in the environment of 'Set up termsel', else that on PATH.

    Raises
    ------
    QgsProcessingException
        If there is none, or the setting or the variable names no file.
    """
    stated = QgsSettings().value(SETTING, "", type=str) or os.environ.get("TERMSEL_EXECUTABLE", "")
    if stated:
        path = Path(stated)
        # A user may state the virtual environment instead of the command in it.
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
    """Run a command to its end, show its messages and progress, and return what it prints.

    Cancelling ends the process, and those it began, within two seconds.

    Parameters
    ----------
    arguments : list
        Arguments of the command, as text or as what `str` makes text.
    feedback : QgsProcessingFeedback
        Where messages and progress are shown, and where the user cancels.
    program : str, optional
        Path of the program, by default of the command termsel.
    show : bool
        Whether what it prints to stdout is shown in the log, instead of being returned.

    Returns
    -------
    str
        What the command printed to stdout; "" with `show`.

    Raises
    ------
    QgsProcessingException
        If the command cannot be run, fails or is cancelled; if it fails, with its own message.
    """
    command = [program or find_termsel_command(), *map(str, arguments)]
    feedback.pushCommandInfo(" ".join(command))
    # A group of its own, so that cancelling can end it with the processes that it began.
    options = ({"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
               if _WINDOWS else {"start_new_session": True})
    try:
        # A list needs no shell, and the program is the one of the user's own settings.
        process = subprocess.Popen(  # nosec B603
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
            env=clean_environment(), encoding="utf-8", errors="replace", **options)
    except OSError as error:
        raise QgsProcessingException(f"{command[0]} cannot be run: {error.strerror}.") from error
    printed = []
    messages = queue.Queue()
    take_printed = messages.put if show else printed.append
    # A thread reads each stream: the command would wait for ever once a pipe is full.
    readers = [threading.Thread(target=_read_lines, args=(stream, take), daemon=True)
               for stream, take in ((process.stdout, take_printed),
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
        # The message begins at the first line with "Error:"; a command that has none, such as pip,
        # says at its end why it failed: the last three lines.
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
    """Show the messages that wait in a queue: progress in the bar, and others in the log.

    Messages other than progress are appended to `lines`, too.
    """
    while not messages.empty():
        line = messages.get().rstrip()
        # The option --progress json makes termsel write such lines.
        if line.startswith('{"progress"'):
            step = json.loads(line)
            if step["progress"] is not None:
                feedback.setProgress(100 * step["progress"])
            feedback.setProgressText(" ".join(filter(None, (step["what"], step["state"]))))
        elif line:
            lines.append(line)
            # QGIS shows an error itself, by the exception that `run` raises.
            if line.startswith("Error:"):
                continue
            if line.startswith(("Warning", "Note")):
                feedback.pushWarning(line)
            else:
                feedback.pushInfo(line)


def _remove_leftovers(number, command):
    """Remove the hidden folders that a killed process of termsel left behind.

    `number` is the process id, and `command` its list of arguments.
    """
    # termsel writes to a hidden folder beside the file to be written, and renames it at the end.
    # Which argument is that file is not known here, so the parent folders of all are searched.
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
