"""A frame of the timeline -> Gaussians -> points: handlers, retiming, cache, prefetch, level of detail."""
