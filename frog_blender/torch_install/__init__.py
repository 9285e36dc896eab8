"""torch for training, installed by one button into a folder of its own."""
