"""What several parts of the network are built of."""
