"""Certificates of proofs and an open benchmark, as a plugin of termsel."""
