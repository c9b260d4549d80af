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
# Debian has these two modules in a package of their own, without which no environment can be made.
_SUITS = "import ensurepip, venv, sys; sys.exit(sys.version_info < (3, 11))"


class SetUp(Algorithm):
    """Make the environment, or state where termsel is."""

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
        """Make an environment, or check the one that is given, and return its version of termsel.
        """
        stated = self.parameterAsString(parameters, "ENVIRONMENT", context)
        folder = Path(stated) if stated else own_environment()
        if not stated:
            _make(folder, _split_words(self.parameterAsString(parameters, "PACKAGES", context)),
                  feedback)
        # The command shows that the environment has termsel; its version, that it runs.
        command = command_in(folder)
        if not command.is_file():
            raise QgsProcessingException(f"{folder} has no command termsel.")
        version = run(["--version"], feedback, str(command)).strip()
        QgsSettings().setValue(SETTING, str(command))
        feedback.pushInfo(version)
        return {"VERSION": version}


def _make(folder, packages, feedback):
    """Make an environment with packages; if that fails, remove it unless it was there before.

    Raises QgsProcessingException if it fails, or no package is named.
    """
    if not packages:
        raise QgsProcessingException("State the packages to install, or an environment that has "
                                     "termsel.")
    # An environment that was there before is not removed when an installation fails.
    new = not folder.exists()
    # venv first, then pip of the new environment, so that nothing of QGIS's Python is touched.
    try:
        run(["-m", "venv", folder], feedback, _find_python(feedback), show=True)
        run(["-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off",
             *packages], feedback, str(command_in(folder, "python")), show=True)
    except QgsProcessingException:
        if new:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _split_words(text):
    """Return the words of a text; [] of a blank one.

    Quotes keep spaces together, and a backslash is one of a path.
    """
    words = []
    remainder = text.strip()
    while remainder:
        # A quote ends at the same quote, all else at the next blank.
        end = " "
        if remainder[0] in "'\"":
            end = remainder[0]
            remainder = remainder[1:]
        argument, _, remainder = remainder.partition(end)
        words.append(argument)
        remainder = remainder.strip()
    return words


def _find_python(feedback):
    """Return a Python that can make the environment.

    That of QGIS may be too old, or the application itself.
    """
    qgis_python = Path(sys.prefix) / ("python.exe" if sys.platform == "win32" else "bin/python3")
    candidates = [path for path in map(shutil.which, (*_PYTHONS, str(qgis_python))) if path]
    # Each once: several names may be one program.
    for path in dict.fromkeys(candidates):
        try:
            run(["-c", _SUITS], feedback, path)
        except QgsProcessingException:
            if feedback.isCanceled():
                raise
            continue
        return path
    raise QgsProcessingException(
        "No Python can make the environment: it takes 3.11 or later with the modules venv and "
        "ensurepip (in Debian: apt install python3-venv). Tried: "
        f"{', '.join(candidates) or 'none'}.")
