"""Built-in commands.

They are all that ``termsel --help`` reads: modules of commands, and plugins, are imported when a
command is used.
"""

COMMANDS = {
    "run": ("termsel.cli.run:run", "Search for the terms or control features that serve best."),
    "compare": ("termsel.cli.compare:compare",
                "Compare problems, models and solvers over many seeds, or run many images."),
    "export": ("termsel.cli.export:export",
               "Write a result for GDAL, QGIS, OTB, Orthority and others."),
    "report": ("termsel.cli.report:report",
               "Write a page about a result or a study that opens in any browser, without "
               "a connection."),
    "plot": ("termsel.cli.plot:plot", "Draw a chart of a result as SVG, PNG or PDF."),
    "project": ("termsel.cli.project:project",
                "Compute image positions of ground points, or ground positions of image points."),
    "rectify": ("termsel.cli.rectify:rectify",
                "Resample an image to a map, by GDAL's warper through the fitted model."),
    "plan": ("termsel.cli.plan:plan", "Rank the places where further control points help most."),
    "list": ("termsel.cli.list:list_", "List what can be asked for by name."),
    "describe": ("termsel.cli.describe:describe",
                 "Describe a problem, model, solver or anything else that has a name."),
    "plugins": ("termsel.cli.plugins:plugins", "List plugins, and what is wrong with them."),
    "new-plugin": ("termsel.cli.new_plugin:new_plugin",
                   "Write a package with a plugin that works, to be changed into yours."),
    "example": ("termsel.cli.example:example",
                "Write the files of the tutorial and of the how-to guides."),
    "completion": ("termsel.cli.completion:completion",
                   "Print a script that completes commands and names in a shell."),
}
"""Built-in commands by name: where the command is, as "module:attribute", and its summary."""
