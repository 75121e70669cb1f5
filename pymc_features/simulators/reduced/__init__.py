"""Modes of many large sparse structures that differ in theta alone, in one basis that holds those of all.

`basis`: columns V, and the matrices V' A_i V. `inertia`: how many frequencies lie below a bound.
`candidates`: the modes in the basis, which of them are right, and none missing. `known`: the bases of a
process, which grow by the modes of those structures that they do not hold.
"""
