"""Certificates of proofs, and files of studies for IOHprofiler, for termsel."""
