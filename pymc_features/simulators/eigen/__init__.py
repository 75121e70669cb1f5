"""Eigenproblems of many structures at once, one in each vector lane, and the modes put into their march."""
