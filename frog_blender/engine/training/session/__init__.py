"""One training run: job, events, checkpoints, resume, export."""
