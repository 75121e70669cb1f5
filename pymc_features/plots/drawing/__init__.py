"""What figures have in common: their axes, long histories, and structures in space."""
