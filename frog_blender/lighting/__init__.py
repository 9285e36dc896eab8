"""What a capture lends to objects of other engines: its light, and a mesh that casts and catches their shadows."""
