"""Shards as a dataset in somebody else's format."""
