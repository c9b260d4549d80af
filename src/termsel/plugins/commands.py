"""Built-in commands.

They are all that ``termsel --help`` reads: modules of commands, and plugins, are imported when a
command is used.
"""

COMMANDS = {
    "run": ("termsel.cli.run:run",
            "Fit a model to control points or lines, and report its accuracy."),
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
                "Resample an image to a map, or all images of a batch."),
    "plan": ("termsel.cli.plan:plan", "Rank positions at which further control points help most."),
    "list": ("termsel.cli.list:list_", "List available models, solvers, readers and so on."),
    "describe": ("termsel.cli.describe:describe",
                 "Describe a problem, model, solver or other named thing."),
    "plugins": ("termsel.cli.plugins:plugins", "List installed plugins, and errors in them."),
    "new-plugin": ("termsel.cli.new_plugin:new_plugin",
                   "Write a package with a working plugin, as a start for yours."),
    "example": ("termsel.cli.example:example",
                "Write the files of the tutorial and of the how-to guides."),
    "completion": ("termsel.cli.completion:completion",
                   "Print a script that completes commands and names in a shell."),
}
"""Built-in commands by name: where the command is, as "module:attribute", and its summary."""

GROUPS = {
    "Fit": ("run", "block", "auto-georeference", "map-series", "stability", "app"),
    "Check": ("check", "accuracy", "sigma", "plan"),
    "Export": ("export", "rectify", "project", "report", "plot"),
    "Images": ("match-points", "match-lines", "match-ties", "block-points", "block-select",
               "flight-camera"),
    "Research": ("compare", "bench"),
    "Extend": ("list", "describe", "plugins", "new-plugin", "example", "match-example",
               "block-example", "completion"),
}
"""Names of commands by what they are for, in the order of ``termsel --help``."""

PACKAGES = {
    "termsel_app": {"app": "Georeference an image in the browser."},
    "termsel_bench": {"bench": "Compare methods of georeferencing on forty data sets."},
    "termsel_block": {
        "block": "Adjust several images together, by their tie points.",
        "block-points": "Write the ground positions of a block's ties as points.",
        "block-select": "Select which control points and ties of a block to use.",
        "block-example": "Write a simulated block: images with RPCs, ties, control."},
    "termsel_formats": {"check": "Show which transformation other programs will use."},
    "termsel_match": {
        "auto-georeference": "Make a map of a raw image: match it, fit it, rectify it.",
        "match-points": "Find control points by matching an image with a map.",
        "match-lines": "Find control lines by matching an image with vectors.",
        "match-ties": "Find tie points that two raw images share.",
        "match-example": "Write a simulated image, map and vectors to match."},
    "termsel_cameras": {
        "map-series": "Find what all sheets of a series share: projection and paper.",
        "flight-camera": "Find the camera that the photos of one flight share."},
    "termsel_standards": {
        "accuracy": "State the accuracy by ASPRS, NSSDA and ISO 19157.",
        "sigma": "Write the uncertainty of a result as a raster."},
    "termsel_studies": {"stability": "Show how often each term is selected as points change."},
}
"""Commands of the packages next to termsel, so that help shows them without importing them."""
