"""Estimates under a prior: shrunken polynomials, random fields, splines, blunders."""
