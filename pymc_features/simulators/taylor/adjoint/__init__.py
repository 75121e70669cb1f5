"""Gradients of chains with nonlinear springs: the Taylor steps of the march in reverse."""
