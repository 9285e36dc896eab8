"""The rasterizer on NVIDIA GPUs: the mathematics of ``src/shared`` in CUDA C++, compiled at first use.

``rasterize`` draws; ``binning`` is its part; ``launch`` speaks to the driver, ``compile`` and
``nvrtc`` to the compiler; ``sources`` lists what there is to compile. Nothing here is imported before it is needed.
"""
