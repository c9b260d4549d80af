"""Algorithms of DEAP and pymoo on problems of termsel, and the reverse."""
