"""Features in; losses, or scored boxes, out."""
