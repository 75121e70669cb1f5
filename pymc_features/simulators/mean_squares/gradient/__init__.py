"""Gradients of sums of squared misfits from tables, of structures in vector lanes, under one input.

What a gradient needs of the history are sums of w = dL/dy times the outputs of each mode and times their
derivatives (`oscillators.gradient`). As the output o = 2 Re(C v) depends on the pole by C and v,

    sum_k w_j do/dx = 2 Re(dC/dx w_j'v + C dlambda/dx w_j'v'),   v' = dv/dlambda,

and w is a sum of data, inputs and outputs of modes again. So beside the functions of the table and the
products of two modes it takes their derivatives by lambda: the functions have an interpolating polynomial for
it, and the products M_rs = v_r'v_s follow from (1 - E_r E_s) M_rs = N_rs,

    (1 - E_r E_s) dM_rs/dlambda_r = dN_rs/dlambda_r + h E_r E_s M_rs.
"""
