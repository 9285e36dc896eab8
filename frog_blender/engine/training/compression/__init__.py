"""What a scene does not need is pruned, frozen or shrunk: proposed, judged on validation images, applied, logged."""
