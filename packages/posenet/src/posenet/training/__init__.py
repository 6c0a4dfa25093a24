"""From shards to a trained network."""
