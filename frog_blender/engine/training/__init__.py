"""How a scene is learned. Needs torch, which playing a finished scene does not."""
