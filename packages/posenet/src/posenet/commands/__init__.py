"""The `posenet` command."""
