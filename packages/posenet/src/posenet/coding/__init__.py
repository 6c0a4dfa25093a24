"""Between poses and what a network predicts: bins, angles, offsets, the Sym distance in torch."""
