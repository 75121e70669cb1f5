"""A Gaussian process that stands for an external simulator where it is sure enough."""
