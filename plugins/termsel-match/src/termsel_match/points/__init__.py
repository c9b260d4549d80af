"""Candidates of control points, matched here or by other programs."""
