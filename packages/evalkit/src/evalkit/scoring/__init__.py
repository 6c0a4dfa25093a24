"""How good predictions are: distances, matching, curves, AP, and how much of it is chance."""
