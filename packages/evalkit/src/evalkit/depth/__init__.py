"""Depth images from files, whoever took them, as meters."""
