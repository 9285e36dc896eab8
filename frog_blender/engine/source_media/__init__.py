"""The capture's own videos: where they lie, and copies without lens distortion."""
