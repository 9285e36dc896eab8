"""A .frog file and a time -> Gaussians and images, in numpy and the native library, without torch."""
