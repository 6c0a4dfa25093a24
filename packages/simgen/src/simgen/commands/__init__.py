"""The `simgen` command."""
