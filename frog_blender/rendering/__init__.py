"""What the FROG engine draws besides the rasterizer: pixels of passes, what hides splats, viewports."""
