"""Corrupted captures: conditions under which methods fail, each a function of a clean capture."""
