"""Kernels on NVIDIA GPUs: CUDA C++, compiled at first use.

``launch`` speaks to the driver, ``compile`` and ``nvrtc`` to the compiler; ``sources`` lists what there is to compile.
``field``, ``loss`` and ``adam`` are parts of a training's step; its drawing is in ``rasterizer.cuda``.
"""
