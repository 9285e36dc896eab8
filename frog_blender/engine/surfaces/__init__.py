"""Gaussians to surfaces: depth images fused into meshes, for programs and effects that need geometry."""
