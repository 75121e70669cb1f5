"""Compilation of the kernels, and how their machine code is kept on disk."""
