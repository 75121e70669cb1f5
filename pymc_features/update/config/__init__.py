"""What `update.toml` may hold, checked."""
