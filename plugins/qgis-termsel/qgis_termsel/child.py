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
"""What QGIS sets for its own Python and would break another, and what would silence pip's log."""

# Seconds between the request to end and the end.
_GRACE = 1.0
_WINDOWS = sys.platform == "win32"


def own_environment():
    """Return the folder of the environment that 'Set up termsel' makes, whether it exists or not.
    """
    return Path(QgsApplication.qgisSettingsDirPath()) / "termsel-environment"


def find_termsel_command():
    """Return the command termsel: of the settings, of the own environment, or on PATH.

    Raises
    ------
    QgsProcessingException
        If there is none.
    """
    # The setting comes before the variable of the environment.
    stated = QgsSettings().value(SETTING, "", type=str) or os.environ.get("TERMSEL_EXECUTABLE", "")
    if stated:
        path = Path(stated)
        # A virtual environment.
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
    """Return the environment variables, as a new dict, without those of QGIS's own Python."""
    variables = {name: value for name, value in os.environ.items() if name not in _REMOVED}
    variables["PYTHONIOENCODING"] = "utf-8"
    # Modules of the folder of a project are not Python's own.
    variables["PYTHONSAFEPATH"] = "1"
    variables["NO_COLOR"] = "1"
    variables["COLUMNS"] = "100"
    return variables


def run(arguments, feedback, program=None, show=False):
    """Run a command to its end, show its messages and progress, and return its stdout.

    With ``show`` the log has its stdout, too.

    Cancelling ends the process, and those it began, within two seconds.

    Raises
    ------
    QgsProcessingException
        With the message of the command, if it fails or is cancelled.
    """
    command = [program or find_termsel_command(), *map(str, arguments)]
    feedback.pushCommandInfo(" ".join(command))
    # A group of its own, so that cancelling ends the processes that the command began, too.
    options = ({"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
               if _WINDOWS else {"start_new_session": True})
    try:
        # A list and no shell; the program is that of the user's own settings.
        process = subprocess.Popen(  # nosec B603
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
            env=clean_environment(), encoding="utf-8", errors="replace", **options)
    except OSError as error:
        raise QgsProcessingException(f"{command[0]} cannot be run: {error.strerror}.") from error
    printed = []
    messages = queue.Queue()
    stdout = messages.put if show else printed.append
    # Two threads read both streams: a full pipe would stop the command.
    readers = [threading.Thread(target=_read, args=(process.stdout, stdout), daemon=True),
               threading.Thread(target=_read, args=(process.stderr, messages.put), daemon=True)]
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
            # A batch runs here: its button Cancel must work.
            QCoreApplication.processEvents()
        time.sleep(0.05)
    _forward_messages(messages, feedback, lines)
    if process.returncode:
        # From the first line with "Error:" on, else the last three lines.
        first = next((at for at, line in enumerate(lines) if line.startswith("Error:")), -3)
        raise QgsProcessingException(" ".join(lines[first:]) or f"{command[0]} ended with code "
                                     f"{process.returncode}.")
    return "".join(printed)


def _read(stream, take):
    """Call `take` with each line of a stream as it comes, and close the stream at its end."""
    with stream:
        for line in stream:
            take(line)


def _forward_messages(messages, feedback, lines):
    """Take the waiting messages: progress to the bar, all others to the log.

    The others are appended to `lines`, too; errors only there, as the exception shows them.
    """
    while not messages.empty():
        line = messages.get().rstrip()
        # Lines of --progress json are for the progress bar, all others for the log.
        if line.startswith('{"progress"'):
            step = json.loads(line)
            if step["progress"] is not None:
                feedback.setProgress(100 * step["progress"])
            feedback.setProgressText(" ".join(filter(None, (step["what"], step["state"]))))
        elif line:
            lines.append(line)
            if line.startswith("Error:"):
                # The exception shows it.
                continue
            if line.startswith(("Warning", "Note")):
                feedback.pushWarning(line)
            else:
                feedback.pushInfo(line)


def _remove_leftovers(number, command):
    """Remove the folders in which a process that was killed had begun to write.

    `number` is that of the process, `command` its arguments, whose folders are searched.
    """
    # Folders in which a command writes are those of its files; the number is that of its process.
    for folder in {Path(argument).absolute().parent for argument in command[1:]}:
        for leftover in folder.glob(f".termsel-*-{number}-*"):
            shutil.rmtree(leftover, ignore_errors=True)


def _end_process_tree(process):
    """End a process and those that it began: by Ctrl-C, and by force if that takes too long."""
    if _WINDOWS:
        taskkill = Path(os.environ["SYSTEMROOT"]) / "System32" / "taskkill.exe"
        subprocess.run(  # nosec B603: of Windows itself
            [str(taskkill), "/F", "/T", "/PID", str(process.pid)], check=False, capture_output=True)
        return
    # As Ctrl-C: termsel then removes what it has begun.
    os.killpg(process.pid, signal.SIGINT)
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
