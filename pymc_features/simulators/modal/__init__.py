"""Natural frequencies, mode shapes at sensors and modal damping of all families, and their gradients.

Each kernel takes a population: the parameters of a family with one more axis in front, a row for each
particle or one for all, and the `Outputs` wanted, of which the degrees of freedom and the number of modes
count.

modes           frequencies (p, m) [Hz], shapes (p, m, s) and damping ratios (p, m) [-]
modes_gradient  takes a `Cotangent` of these, returns gradients in the shapes of the parameters

frequencies     natural frequencies (p, m) [Hz] alone, without anything compiled; takes the number of modes

Rows that describe no structure are NaN.
"""
