"""How a scene is learned. Needs torch, which playing a finished scene does not."""

import os

# torch's OpenMP threads spin after each operation and slow the rasterizer's own threads to a third; let them sleep.
# Takes effect when torch has not been loaded yet.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
