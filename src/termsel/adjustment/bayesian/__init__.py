"""Estimates under a prior: regularised polynomials, random fields, splines, blunders."""
