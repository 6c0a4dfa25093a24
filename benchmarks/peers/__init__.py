"""Classical peers, on the same images as the network: point pair features and Linemod, bare and post-processed."""
