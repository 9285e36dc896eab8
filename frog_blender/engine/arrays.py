"""Types of arrays that several rooms exchange; docstrings give their shapes."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# numpy's stubs lose an array's number type in most arithmetic: docstrings say it, and files are checked when read.
Array: TypeAlias = NDArray[Any]

Bools: TypeAlias = NDArray[np.bool_]
Ints: TypeAlias = NDArray[np.int64]
Float32s: TypeAlias = NDArray[np.float32]
Float64s: TypeAlias = NDArray[np.float64]
Floats: TypeAlias = Float32s | Float64s
ImageArray: TypeAlias = NDArray[np.uint8]
"""(H, W, 3) display-referred sRGB, or (H, W) brightness."""

SceneArrays: TypeAlias = dict[str, Array]
"""A scene file's arrays by name. The canonical field: ``means`` (N, 3), ``log_scales`` (N, 3), ``quaternions`` (N, 4),
``opacity_logits`` (N,), ``sh`` (N, K, 3), and ``embeddings`` (M, E) of the deformed Gaussians, which come first.
Besides them ``temporal_table`` (rows, T) and the network's layers as ``network.*``."""

NetworkArrays: TypeAlias = dict[str, Array]
"""A deformation network's layers by the native library's names: ``embedding_weight`` (units, E), ``temporal_weight``
(units, T), ``bias`` (units,), ``output_weight`` (outputs, inputs), ``output_bias`` (outputs,) and, with heads of their
own, ``head_weight`` and ``head_bias``; see model.deformation.DeformationField."""
