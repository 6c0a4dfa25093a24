"""What steps along the gradients, and how fast."""
