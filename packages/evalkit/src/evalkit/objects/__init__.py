"""What an object is: surface, size, symmetry, and how far off a pose may be."""
