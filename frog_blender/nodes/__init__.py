"""How engines other than FROG draw Gaussians: Geometry Nodes and materials."""
