"""Geometry Nodes and materials that draw Gaussians in engines other than FROG."""
