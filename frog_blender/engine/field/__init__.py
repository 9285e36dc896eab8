"""What training and playback both know of the deformable field, in numpy: names, temporal table, first layer."""
