"""One run: task, search, assessment."""
