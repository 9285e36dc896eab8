"""Crop, selections, grade: edits by Gaussian, which everyone who plays the edited scene gets. No torch."""
