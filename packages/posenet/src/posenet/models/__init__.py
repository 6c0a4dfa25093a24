"""A trained model on disk: its file, packed for travel, and as ONNX."""
