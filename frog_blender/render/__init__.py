"""The FROG render engine: collecting, holdout, passes, final renders, viewport renders."""
