"""Scenes to and from other programs: 3DGS .ply files."""
