"""What a real depth camera makes of ideal depth."""
