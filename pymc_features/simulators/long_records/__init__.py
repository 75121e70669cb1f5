"""Mean squares of the misfit under long records, from tables, at a cost that does not grow with the record.

The output of a mode obeys y[k+1] = e y[k] + c a[k], see `oscillators.exact_step`. What a sum of squared
misfits needs of record and data are sums sum_k b[k] y[k], of the data and of the inputs for b: polynomials in
e = exp(z), and so entire functions of the pole z, that are interpolated between nodes (`table`). Products of
two modes follow from their recursions (`sums`). `misfits` takes both together, and marches what is not sure.
"""
