"""Charts of a result, one definition for pages, notebooks and pictures."""
