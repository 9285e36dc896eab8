"""Sinks for TensorBoard and Weights & Biases: `pip install -e examples/loggers`, then `frog train --sink NAME`."""
