"""Kernels of chains whose springs are nonlinear."""
