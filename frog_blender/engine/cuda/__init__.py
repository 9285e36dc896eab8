"""Kernels on NVIDIA GPUs: CUDA C++, compiled at first use.

``launch`` speaks to the driver, ``compile`` and ``nvrtc`` to the compiler; ``sources`` lists what there is to compile.
Nothing here is imported before it is needed.
"""
