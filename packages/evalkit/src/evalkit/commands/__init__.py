"""The `evalkit` command, and how all three commands meet the user."""
