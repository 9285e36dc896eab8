"""One training step: losses, optimizer, densification, schedules, per-camera quantities."""
