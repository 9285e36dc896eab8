"""Lengths of time in words."""

from __future__ import annotations


def about(seconds: float) -> str:
    """No more precisely than an estimate is: 48 -> "50 seconds", 250 -> "4 minutes", 9000 -> "2.5 hours"."""
    if seconds < 95:
        return f"{max(10, round(seconds, -1)):.0f} seconds"
    if seconds < 95 * 60:
        minutes = seconds / 60
        return f"{round(minutes) if minutes < 20 else 5 * round(minutes / 5)} minutes"
    return f"{seconds / 3600:.1f}".removesuffix(".0") + " hours"
