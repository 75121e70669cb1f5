"""Chains with nonlinear springs by Taylor steps, one chain in each lane of a vector register."""
