"""Kernels for `pm.sample_smc`, one a file."""
