"""Matchers: two windows as arrays, and the places in them that look alike."""
