"""Poses fitted to the depth image itself, and what the image says of them."""
