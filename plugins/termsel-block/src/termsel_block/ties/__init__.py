"""Ties as other programs write them."""
