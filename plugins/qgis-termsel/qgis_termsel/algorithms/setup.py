"""Install termsel in an environment of its own."""

import shutil
import sys
from pathlib import Path

from qgis.core import (
    QgsProcessingException,
    QgsProcessingOutputString,
    QgsProcessingParameterFile,
    QgsProcessingParameterString,
    QgsSettings,
)

from ..child import SETTING, command_in, own_environment, run
from .base import FOLDER, Algorithm

_PACKAGES = "termsel[gis,report,tables] termsel-formats termsel-rpc"
_PYTHONS = ("python3.13", "python3.12", "python3.11", "python3", "python")
# A program that fails in a Python that cannot make an environment for termsel. Debian has the two
# modules in a package of their own.
_TEST_OF_PYTHON = "import ensurepip, venv, sys; sys.exit(sys.version_info < (3, 11))"


class SetUp(Algorithm):
    """Installs termsel in an environment of its own, or takes one that has it."""

    NAME, TITLE, GROUP = "setup", "Set up termsel", "Setup"
    HELP = ("Installs termsel in a separate virtual environment, with python -m venv and pip; "
            "the log shows their output. Or state an environment that has termsel.\n\n"
            "Packages are names of a package index or folders, with spaces between them. Quote a "
            "path with a space.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(QgsProcessingParameterFile(
            "ENVIRONMENT", "Virtual environment that has termsel", behavior=FOLDER, optional=True))
        self.addParameter(QgsProcessingParameterString("PACKAGES", "Packages to install",
                                                       defaultValue=_PACKAGES, optional=True))
        self.addOutput(QgsProcessingOutputString("VERSION", "Version"))

    def processAlgorithm(self, parameters, context, feedback):
        """Make an environment with termsel, or take the one that is given; return its version.

        From then on all algorithms run the command termsel of this environment. Raises
        QgsProcessingException if it cannot be made, or has no such command.
        """
        stated = self.parameterAsString(parameters, "ENVIRONMENT", context)
        folder = Path(stated) if stated else own_environment()
        if not stated:
            packages = _split_words(self.parameterAsString(parameters, "PACKAGES", context))
            _make_environment(folder, packages, feedback)
        # The command shows that the environment has termsel; its version, that it runs.
        command = command_in(folder)
        if not command.is_file():
            raise QgsProcessingException(f"{folder} has no command termsel.")
        version = run(["--version"], feedback, str(command)).strip()
        QgsSettings().setValue(SETTING, str(command))
        feedback.pushInfo(version)
        return {"VERSION": version}


def _make_environment(folder, packages, feedback):
    """Make a virtual environment in `folder`, and install `packages` in it.

    If that fails or is cancelled, the folder is removed, unless it was there before.

    Raises
    ------
    QgsProcessingException
        If it fails or is cancelled, or `packages` is empty.
    """
    if not packages:
        raise QgsProcessingException("State the packages to install, or an environment that has "
                                     "termsel.")
    is_new = not folder.exists()
    try:
        run(["-m", "venv", folder], feedback, _find_python(feedback), show=True)
        # By the new environment's own pip, so that nothing of QGIS's Python is touched.
        run(["-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off",
             *packages], feedback, str(command_in(folder, "python")), show=True)
    except QgsProcessingException:
        if is_new:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _split_words(text):
    """Return the words of a text, which spaces separate; [] for a blank text.

    A word in quotes may have spaces. Backslashes are kept, as those of paths on Windows; shlex
    would take them for escapes.
    """
    words = []
    remainder = text.strip()
    while remainder:
        # A quoted word ends at the same quote, any other at the next space.
        end = " "
        if remainder[0] in "'\"":
            end = remainder[0]
            remainder = remainder[1:]
        argument, _, remainder = remainder.partition(end)
        words.append(argument)
        remainder = remainder.strip()
    return words


def _find_python(feedback):
    """Return the path of a Python that can make the environment, the newest on PATH first.

    Raises
    ------
    QgsProcessingException
        If there is none, or the user cancels.
    """
    # QGIS's own Python may be too old, and sys.executable may be QGIS itself.
    qgis_python = Path(sys.prefix) / ("python.exe" if sys.platform == "win32" else "bin/python3")
    candidates = [path for path in map(shutil.which, (*_PYTHONS, str(qgis_python))) if path]
    # Several names may lead to one program, which is tried once.
    for path in dict.fromkeys(candidates):
        try:
            run(["-c", _TEST_OF_PYTHON], feedback, path)
        except QgsProcessingException:
            if feedback.isCanceled():
                raise
            continue
        return path
    raise QgsProcessingException(
        "No Python can make the environment: it takes 3.11 or later with the modules venv and "
        "ensurepip (in Debian: apt install python3-venv). Tried: "
        f"{', '.join(candidates) or 'none'}.")
