"""Bouc-Wen springs: the law, and its Taylor series."""
