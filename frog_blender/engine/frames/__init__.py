"""Decoded frames on disk: kept without loss, read in parts, limited in size."""
