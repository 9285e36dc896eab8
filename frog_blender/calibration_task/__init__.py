"""Calibration of raw videos in a background thread, and its state for the panel."""
