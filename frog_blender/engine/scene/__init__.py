"""The .frog file: header, arrays, quantization, Morton order, and what it says of its compression."""
