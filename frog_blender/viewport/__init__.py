"""Splats drawn by the graphics card in viewports of every shading mode, with the scene's depth (Blender's gpu)."""
