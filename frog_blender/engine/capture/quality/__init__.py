"""Whether a capture can be trained on, measured in its images before an hour is spent: ``frog info --check``."""
