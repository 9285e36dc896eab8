"""The one place that turns frames into times and back."""


def frame_to_time(frame: float, frame_count: int) -> float:
    """Time in [0, 1] of a frame counted from 0; fractions of frames are legal."""
    return float(frame) / max(frame_count - 1, 1)


def time_to_frame(time: float, frame_count: int) -> float:
    """Frame counted from 0 (with fraction) of a time in [0, 1]."""
    return float(time) * max(frame_count - 1, 1)
