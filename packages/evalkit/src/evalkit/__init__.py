"""Poses, cameras, symmetry, datasets on disk, and how good a prediction is."""
