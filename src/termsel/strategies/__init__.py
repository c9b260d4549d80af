"""Strategies: what to do with points when no method is asked for by name."""
