"""Trainers flush denormal numbers for the whole process; the other tests get them back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch


@pytest.fixture(scope="session", autouse=True)
def denormals_as_before() -> Iterator[None]:
    np.finfo(np.float64)  # looked up once; with denormals flushed it would warn
    yield
    torch.set_flush_denormal(False)
