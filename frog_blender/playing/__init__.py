"""Which moments a capture shows, which are kept and computed ahead, and how many of its Gaussians."""
