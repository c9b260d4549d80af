"""What all algorithms share."""

import shutil
from pathlib import Path

from qgis.core import (
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingParameterFile,
    QgsProcessingUtils,
)
from qgis.PyQt.QtGui import QIcon

from ..provider import ICON

FOLDER = QgsProcessingParameterFile.Behavior.Folder


class Algorithm(QgsProcessingAlgorithm):
    """An algorithm that runs a command of termsel.

    Attributes
    ----------
    NAME, TITLE, GROUP, HELP : str
        Name after the colon, name and group in the toolbox, and text of the dialog.
    """

    NAME = TITLE = GROUP = HELP = ""

    def name(self):
        """Return the name after the colon."""
        return self.NAME

    def displayName(self):
        """Return the name in the toolbox."""
        return self.TITLE

    def group(self):
        """Return the group in the toolbox."""
        return self.GROUP

    def groupId(self):
        """Return the group's name."""
        return self.GROUP.lower()

    def shortHelpString(self):
        """Return the text of the dialog."""
        return self.HELP

    def icon(self):
        """Return the icon in the toolbox."""
        return QIcon(ICON)

    def createInstance(self):
        """Return another one."""
        return type(self)()


def with_page(outputs, name, page, feedback):
    """Return outputs with a page for the results viewer.

    The batch of QGIS 3.22 fails when it has run all rows and one of them has a page: its own
    feedback shows that it is one, and then the page is a file in the folder alone.
    """
    if type(feedback).__name__ == "BatchFeedback":
        return outputs
    return {**outputs, name: str(page)}


def result_parameter():
    """Return the parameter of a folder that has a result."""
    return QgsProcessingParameterFile("RESULT", "Folder of the result", behavior=FOLDER)


def layer_file(layer, description):
    """Return the file of a raster or vector layer.

    Raises
    ------
    QgsProcessingException
        If it has none, such as a layer of a server.
    """
    # Layers of files have options after a bar, such as |layername=roads.
    path = layer.source().split("|")[0]
    if not Path(path).exists():
        raise QgsProcessingException(f"The {description} must be a file; {layer.name()} is none. "
                                     "Export the layer to a file first.")
    return path


def in_place(new_folder, target):
    """Put a folder that is complete where it was asked for."""
    target = Path(target)
    target.mkdir(parents=True, exist_ok=True)
    # result.json comes last: where it is, the folder is complete.
    for file in sorted(Path(new_folder).iterdir(), key=lambda path: path.name == "result.json"):
        # Which a copy to another disk would follow.
        if (target / file.name).is_symlink():
            (target / file.name).unlink()
        shutil.move(str(file), str(target / file.name))


def scratch():
    """Return a folder that does not exist yet."""
    # In the temporary folder of Processing.
    return QgsProcessingUtils.generateTempFilename("result")
