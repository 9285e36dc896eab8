"""A long take trained in segments that share what does not move: the plan, its stages, and the scene joined of them."""
