"""Kernels of linear structures M x" + C x' + K x = load: any matrices, dense or sparse, affine in theta.

Modes are found with LAPACK or ARPACK, once for each set of parameters; what runs over time is compiled.
"""
