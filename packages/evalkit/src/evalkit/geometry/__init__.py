"""Rigid transforms and the pinhole camera, with the files that cameras come in."""
