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
    """Return the outputs of an algorithm, with an HTML page for the results viewer among them.

    `name` is the output's, and `page` the path of its file. In a batch the outputs are returned
    without the page.
    """
    # At its end a batch of QGIS 3.22 fails if a row of it has a page. It is known by its feedback.
    if type(feedback).__name__ == "BatchFeedback":
        return outputs
    return {**outputs, name: str(page)}


def result_parameter():
    """Return the parameter "RESULT", the folder of a result, for algorithms that need one."""
    return QgsProcessingParameterFile("RESULT", "Folder of the result", behavior=FOLDER)


def layer_file(layer, description):
    """Return the path of the file that a raster or vector layer shows.

    `description` says in the message what the layer is for, such as "raster of heights".

    Raises
    ------
    QgsProcessingException
        If the layer has no file, such as a layer of a server.
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
    # result.json comes last (False sorts before True): where it is, the folder is complete.
    for file in sorted(Path(new_folder).iterdir(), key=lambda path: path.name == "result.json"):
        # Between disks a move is a copy, which would write to where the link leads.
        if (target / file.name).is_symlink():
            (target / file.name).unlink()
        shutil.move(str(file), str(target / file.name))


def scratch_folder():
    """Return the path of a folder that does not exist yet, in Processing's temporary folder."""
    return QgsProcessingUtils.generateTempFilename("result")
