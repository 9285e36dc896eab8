"""Which device a training will use, before torch is loaded."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def likely_device(name: str) -> str:
    """What ``choose_device`` will make of a name, without loading torch: "auto" is a GPU where there is a driver."""
    if name != "auto":
        return name
    torch = sys.modules.get("torch")
    if torch is not None:
        return "cuda" if torch.cuda.is_available() else "cpu"
    system = Path(os.environ.get("SYSTEMROOT", r"C:\Windows")) / "System32" / "nvcuda.dll"
    return "cuda" if Path("/proc/driver/nvidia/version").exists() or system.exists() else "cpu"
