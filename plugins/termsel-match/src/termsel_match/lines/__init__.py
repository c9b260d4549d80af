"""Candidates of control lines, and those of them that agree."""
