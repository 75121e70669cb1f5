"""Compilation of the kernels, and vectors of numbers in the registers of the processor."""
