"""Exact posteriors by quadrature, to judge samplers by."""
