"""What a training run is, where it stands, and its models: the run's folder."""
