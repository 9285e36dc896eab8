"""Installation of torch for training, into a folder of its own."""
