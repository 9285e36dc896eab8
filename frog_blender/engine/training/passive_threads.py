"""Loads torch so that its OpenMP threads sleep while they wait; imported by what trains before it imports torch.

They would spin after each operation and slow the rasterizer's own threads to a third. OpenMP reads how it is to wait
from the environment, once; the process, which may be Blender, and the processes that it starts keep theirs. Nothing is
changed where torch has been loaded already.
"""

import os

from . import torch_libraries

_SETTING = "OMP_WAIT_POLICY"

if _SETTING not in os.environ:
    os.environ[_SETTING] = "PASSIVE"
    try:
        torch_libraries.load()  # OpenMP is among them
        import torch

        torch.get_num_threads()  # some OpenMP libraries read their settings at the first call
    finally:
        del os.environ[_SETTING]
