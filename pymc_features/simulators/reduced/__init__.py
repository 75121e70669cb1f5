"""Modes of many large sparse structures that differ in theta alone, by one reduced basis that fits them all.

`basis` (columns V, and the matrices V' A_i V), `eigenproblem` (its modes for given parameters), `inertia` (how
many frequencies lie below a bound), `structures` (which of these modes are good enough, and what becomes of the
others) and `known` (the bases of a process).
"""
