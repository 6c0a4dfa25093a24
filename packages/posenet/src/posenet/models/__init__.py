"""A trained model on disk: its file, and packed for travel."""
