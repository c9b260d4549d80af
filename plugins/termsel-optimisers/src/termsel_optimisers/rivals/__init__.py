"""Solvers, a criterion and a method of the literature that termsel is compared with."""
