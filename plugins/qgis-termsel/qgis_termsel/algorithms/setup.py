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

_PACKAGES = "termsel[gis,report,tables] termsel-rpc"


class SetUp(Algorithm):
    """Make the environment, or state where termsel is."""

    NAME, TITLE, GROUP = "setup", "Set up termsel", "Setup"
    HELP = ("Installs termsel in a virtual environment of its own, with python -m venv and pip; "
            "the log shows all that they say. Or state an environment that has termsel.\n\n"
            "Packages are names of a package index or folders, with spaces between them.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(QgsProcessingParameterFile(
            "ENVIRONMENT", "Virtual environment that has termsel", behavior=FOLDER, optional=True))
        self.addParameter(QgsProcessingParameterString("PACKAGES", "Packages to install",
                                                       defaultValue=_PACKAGES, optional=True))
        self.addOutput(QgsProcessingOutputString("VERSION", "Version"))

    def processAlgorithm(self, parameters, context, feedback):
        """Make or check the environment."""
        stated = self.parameterAsString(parameters, "ENVIRONMENT", context)
        folder = Path(stated) if stated else own_environment()
        if not stated:
            python = _python()
            run(["-m", "venv", folder], feedback, python)
            run(["-m", "pip", "install", "--disable-pip-version-check",
                 *self.parameterAsString(parameters, "PACKAGES", context).split()], feedback,
                str(command_in(folder, "python")))
        command = command_in(folder)
        if not command.is_file():
            raise QgsProcessingException(f"{folder} has no command termsel.")
        version = run(["--version"], feedback, str(command)).strip()
        QgsSettings().setValue(SETTING, str(command))
        feedback.pushInfo(version)
        return {"VERSION": version}


def _python():
    """Return a Python of 3.11 or later: that of QGIS is the application itself on some systems."""
    names = ["python3.13", "python3.12", "python3.11", "python3", "python"]
    own = Path(sys.prefix) / ("python.exe" if sys.platform == "win32" else "bin/python3")
    found = [str(own)] if own.is_file() else []
    found += [path for path in map(shutil.which, names) if path]
    if not found:
        raise QgsProcessingException("No Python was found. Install Python 3.11 or later, or state "
                                     "an environment that has termsel.")
    return found[0]
