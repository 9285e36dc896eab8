"""The C++ library (``src/``) and its ctypes binding."""
