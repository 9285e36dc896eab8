"""What a scene does not need is pruned, frozen or shrunk: proposed, evaluated on validation images, applied, logged."""
