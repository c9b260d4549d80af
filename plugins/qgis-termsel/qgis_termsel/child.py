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

_GRACE = 1.0  # seconds between the request to end and the end
_WINDOWS = sys.platform == "win32"


def own_environment():
    """Return the folder of the environment that 'Set up termsel' makes."""
    return Path(QgsApplication.qgisSettingsDirPath()) / "termsel-environment"


def executable():
    """Return the command termsel: of the settings, of the own environment, or on PATH.

    Raises
    ------
    QgsProcessingException
        If there is none.
    """
    stated = QgsSettings().value(SETTING, "", type=str) or os.environ.get("TERMSEL_EXECUTABLE", "")
    if stated:
        path = Path(stated)
        if path.is_dir():  # a virtual environment
            path = command_in(path)
        if not path.is_file():
            raise QgsProcessingException(
                f"The setting {SETTING} names {stated}, where there is no command termsel.")
        return str(path)
    own = command_in(own_environment())
    found = str(own) if own.is_file() else shutil.which("termsel")
    if not found:
        raise QgsProcessingException(MISSING)
    return found


def command_in(environment, name="termsel"):
    """Return where a virtual environment has a command."""
    return environment / ("Scripts" if _WINDOWS else "bin") / (name + ".exe" * _WINDOWS)


def clean_environment():
    """Return the environment variables without those of QGIS's Python."""
    kept = {name: value for name, value in os.environ.items() if name not in _REMOVED}
    kept["PYTHONIOENCODING"] = "utf-8"
    kept["PYTHONSAFEPATH"] = "1"  # modules of the folder of a project are not Python's own
    kept["NO_COLOR"] = "1"
    kept["COLUMNS"] = "100"
    return kept


def run(arguments, feedback, program=None, show=False):
    """Run a command to its end, show its messages and progress, and return its stdout.

    With ``show`` the log has its stdout, too.

    Cancelling ends the process, and those it began, within two seconds.

    Raises
    ------
    QgsProcessingException
        With the message of the command, if it fails or is cancelled.
    """
    command = [program or executable(), *map(str, arguments)]
    feedback.pushCommandInfo(" ".join(command))
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
    readers = [threading.Thread(target=_read, args=(process.stdout, stdout), daemon=True),
               threading.Thread(target=_read, args=(process.stderr, messages.put), daemon=True)]
    for reader in readers:
        reader.start()
    said = []
    while process.poll() is None or any(reader.is_alive() for reader in readers):
        if feedback.isCanceled():
            _end(process)
            _remove_left(process.pid, command)
            raise QgsProcessingException("Cancelled; nothing was written.")
        _show(messages, feedback, said)
        if QThread.currentThread() == QCoreApplication.instance().thread():
            QCoreApplication.processEvents()  # a batch runs here: its button Cancel must work
        time.sleep(0.05)
    _show(messages, feedback, said)
    if process.returncode:
        first = next((at for at, line in enumerate(said) if line.startswith("Error:")), -3)
        raise QgsProcessingException(" ".join(said[first:]) or f"{command[0]} ended with code "
                                     f"{process.returncode}.")
    return "".join(printed)


def _read(stream, take):
    """Take the lines of a stream as they come."""
    with stream:
        for line in stream:
            take(line)


def _show(messages, feedback, said):
    """Show what has been said since."""
    while not messages.empty():
        line = messages.get().rstrip()
        if line.startswith('{"progress"'):
            step = json.loads(line)
            if step["progress"] is not None:
                feedback.setProgress(100 * step["progress"])
            feedback.setProgressText(" ".join(filter(None, (step["what"], step["state"]))))
        elif line:
            said.append(line)
            if line.startswith("Error:"):
                continue  # the exception shows it
            if line.startswith(("Warning", "Note")):
                feedback.pushWarning(line)
            else:
                feedback.pushInfo(line)


def _remove_left(number, command):
    """Remove the folders in which a process that was killed had begun to write."""
    for folder in {Path(word).absolute().parent for word in command[1:]}:
        for left in folder.glob(f".termsel-*-{number}-*"):
            shutil.rmtree(left, ignore_errors=True)


def _end(process):
    """End a process and those that it began."""
    if _WINDOWS:
        taskkill = Path(os.environ["SYSTEMROOT"]) / "System32" / "taskkill.exe"
        subprocess.run(  # nosec B603: of Windows itself
            [str(taskkill), "/F", "/T", "/PID", str(process.pid)], check=False, capture_output=True)
        return
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C: termsel then removes what it has begun
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
