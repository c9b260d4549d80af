"""Verbs on files: read, export, project, rectify, and the folder of a result."""
