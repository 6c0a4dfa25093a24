"""What a depth image says of poses, without ground truth: which it verifies, and which it contradicts"""
