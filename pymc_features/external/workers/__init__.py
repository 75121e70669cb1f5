"""Simulations, and parts of populations, in processes of their own: here, on a cluster, or anywhere."""
