"""Kernels of spring-mass chains."""
