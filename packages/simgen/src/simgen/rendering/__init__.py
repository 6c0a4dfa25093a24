"""Depth images and labels: the CPU rasterizer, OpenGL, where cameras stand, what is visible."""
