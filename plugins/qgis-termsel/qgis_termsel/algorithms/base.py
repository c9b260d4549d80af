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
        """Return the id of the algorithm, what follows termsel: in scripts."""
        return self.NAME

    def displayName(self):
        """Return the title of the algorithm in the toolbox."""
        return self.TITLE

    def group(self):
        """Return the title of the algorithm's group in the toolbox."""
        return self.GROUP

    def groupId(self):
        """Return the id of the algorithm's group."""
        return self.GROUP.lower()

    def shortHelpString(self):
        """Return the help text beside the dialog."""
        return self.HELP

    def icon(self):
        """Return the icon in the toolbox."""
        return QIcon(ICON)

    def createInstance(self):
        """Return a new instance, as QGIS runs each call on one of its own."""
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


def move_into_place(new_folder, target):
    """Move the files of a complete folder into the folder `target`, result.json last.

    `target` is made if it does not exist; a symbolic link in it is replaced, not followed.
    """
    target = Path(target)
    target.mkdir(parents=True, exist_ok=True)
    # result.json comes last: where it is, the folder is complete.
    for file in sorted(Path(new_folder).iterdir(), key=lambda path: path.name == "result.json"):
        # Which a copy to another disk would follow.
        if (target / file.name).is_symlink():
            (target / file.name).unlink()
        shutil.move(str(file), str(target / file.name))


def scratch_folder():
    """Return the path of a folder that does not exist yet, in Processing's temporary folder."""
    # In the temporary folder of Processing.
    return QgsProcessingUtils.generateTempFilename("result")
