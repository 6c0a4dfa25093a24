"""What a user's own depth images say of their camera: figures, the sensor that reproduces them, and a page on both."""
