"""Mean squares of the misfit of linear structures from tables, at a cost that does not grow with the record.

With the pole lambda of a mode, E = exp(lambda h) and phi1, phi2 of the first-order hold, the output of the
mode is o[k] = 2 Re(C v[k]), where

    v[k+1] = E v[k] + (phi1 - phi2) a[k] + phi2 a[k+1],   v[0] = 0.

The sum of squared misfits is g'g - 2 sum_r S_jr g_j'o_r + sum_rs S_jr S_js o_r'o_s. What it needs of record
and data are functions of lambda alone, g_j'v, a'v and v[N-1] (`correlations`), which are entire and are
interpolated between nodes in the complex plane (`table`). The products of two modes follow by summing the
recursion times itself (`pairs`),

    (1 - E_r E_s) v_r'v_s = - E_r X_r E_s X_s + rho_s U_r + rho_r U_s + phi2_s Q_r + phi2_r Q_s
                            + rho_r rho_s a'a - phi2_r phi2_s a'a,

with rho = phi1 - phi2, X = v[N-1], Q = a'v, U = E (Q - X a[N-1]), the first a'a without the last sample of
the record and the other one without the first.

Where there is an output at every c-th step only, as of a record that is refined c times, the recursion from
one to the next has E^c for E and the inputs' phases a[c n + p], p = 0 ... c - 1, as so many inputs: E^(c-1)
rho stands before phase zero, E^(c-1-p) phi1^2 before the others, and phi2 before a[c n + c].
"""
