"""Gradients of mean squares of many structures at once, one in each lane of a vector register."""
