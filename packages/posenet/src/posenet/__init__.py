"""Multi-task network for the 6D poses of objects in crowds."""
