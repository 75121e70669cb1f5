"""Coefficients of one step of an oscillator under an excitation that is linear over it.

They are functions of F = [[0, 1], [-s, -d]], s = (omega h)^2 and d = D h, see `recursion`. Their closed forms
lose digits for small s and change at critical damping. Here F is halved until the Taylor series converges
fast, then the functions are doubled back by identities without cancellation,

    phi0(2z) = phi0(z)^2,  2 phi1(2z) = (1 + phi0(z)) phi1(z),  4 phi2(2z) = (1 + phi0(z)) phi2(z) + phi1(z),

good for every frequency and damping, rigid-body and overdamped modes included. A function of F is
held as a pair (a, b) standing for a I + b F, since F^2 = -s I - d F.
"""

from pymc_features.simulators.compiled.jit import jit

TAYLOR_TERMS = 13  # with |F| <= 1/4 the first dropped term is below 1e-19
LARGEST = 0.0625  # of s and d^2 in the series


@jit
def first_order_hold(s, d):
    """Coefficients of one step, in the order of the first eight rows of the table.

    Parameters
    ----------
    s, d : float
        (omega h)^2 and D h [-]. With a complex s the imaginary parts are derivatives, see `sensitivity`.
    """
    halvings = 0
    while max(s.real, d * d) > LARGEST:
        s *= 0.25
        d *= 0.5
        halvings += 1
    functions = series(s, d)
    for _ in range(halvings):
        functions = doubled(s, d, functions)
        s *= 4.0
        d *= 2.0
    return hold_coefficients(s, d, functions)


@jit
def series(s, d):
    """Pairs (a, b) of phi0, phi1 and phi2 at an F that is small, of numbers or of vectors of them."""
    a2, b2 = 1.0 + 0.0 * s, 0.0 * s
    for k in range(TAYLOR_TERMS, 2, -1):  # Horner: 2 phi2 = 1 + F/3 (1 + F/4 (1 + ...))
        a2, b2 = 1.0 - s * b2 * (1.0 / k), (a2 - d * b2) * (1.0 / k)
    a2, b2 = 0.5 * a2, 0.5 * b2
    a1, b1 = 1.0 - s * b2, a2 - d * b2  # phi1 = 1 + F phi2
    return 1.0 - s * b1, a1 - d * b1, a1, b1, a2, b2  # phi0 = 1 + F phi1


@jit
def doubled(s, d, functions):
    """These pairs at 2 F, from those at F, with s and d of F."""
    a0, b0, a1, b1, a2, b2 = functions
    grown = 1.0 + a0
    mixed = grown - d * b0
    a2, b2 = 0.25 * (grown * a2 - s * b0 * b2 + a1), 0.125 * (mixed * b2 + b0 * a2 + b1)
    a1, b1 = 0.5 * (grown * a1 - s * b0 * b1), 0.25 * (mixed * b1 + b0 * a1)
    return a0 * a0 - s * b0 * b0, 0.5 * b0 * (2.0 * a0 - d * b0), a1, b1, a2, b2


@jit
def hold_coefficients(s, d, functions):
    """Coefficients of one step, as `first_order_hold` returns them."""
    a0, b0, a1, b1, a2, b2 = functions
    now_q, now_p = b2 - b1, a2 - a1 - d * (b2 - b1)
    return a0, b0, 0.0 - s * b0, a0 - d * b0, now_q, now_p, 0.0 - b2, d * b2 - a2
