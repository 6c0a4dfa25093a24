"""A trained network for what runs without Python: ONNX graphs, and the rules between them."""
