"""One exact step of a mode under an excitation that is linear between its samples.

With z a pole of the structure times the step, u' = z u - a (time in steps) has the exact step

    u[k+1] = phi_0 u[k] - (phi_1 - phi_2) a[k] - phi_2 a[k+1],
    phi_0 = e^z,   phi_1 = (phi_0 - 1)/z,   phi_2 = (phi_1 - 1)/z.

A mode q" + D q' + omega^2 q = -a is such an equation in the numbers re + im J, z = -d/2 + J with
J^2 = d^2/4 - s: then q = h^2 Im(u), q' = h Im(z u), q" + a = Im(z^2 u), where Im is the part beside J. With
y = g (u + phi_2 a), g = h^2, h z or z^2, one term of the excitation is left:

    y[k+1] = e y[k] + c a[k],   output Im(y) - Im(g phi_2) a,
    e = phi_0,   c = g (phi_2 - phi_1 - phi_0 phi_2).

With w = z phi_1 = phi_0 - 1, without its cancellation, c is -w^2 of accelerations, -h phi_1 w of velocities
and -h^2 (phi_1 + phi_2 w) of displacements.

    s, d      (omega h)^2 and D h of a mode [-], lanes or numbers with derivatives
    h         step of the recursion [s]
"""

from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.numbers.compiled_numbers import (
    alike,
    highest,
    larger,
    new_quadratic,
    the_value,
    where_less,
)
from pymc_features.simulators.oscillators.arguments import RELATIVE_DISPLACEMENT, RELATIVE_VELOCITY

TAYLOR_TERMS = 13  # with |z| <= 1/4 the first dropped term is below 1e-19
LARGEST = 0.0625  # of s and d^2 in the series


@jit
def exponentials(z, s, d):
    """phi_0, phi_1 and phi_2 of a number z, halved and doubled in each lane as often as it needs.

    Doubling: phi_0(2z) = phi_0^2, 2 phi_1(2z) = (1 + phi_0) phi_1, 4 phi_2(2z) = (1 + phi_0) phi_2 + phi_1.
    """
    size = larger(s, d * d)
    halvings, factor = alike(size, 0.0), alike(size, 1.0)
    while highest(size) > LARGEST:
        halvings = where_less(LARGEST, size, halvings + 1.0, halvings)
        factor = where_less(LARGEST, size, 0.5 * factor, factor)
        size = where_less(LARGEST, size, 0.25 * size, size)
    z = z * factor
    twice = 1.0 + 0.0 * z
    for k in range(TAYLOR_TERMS, 2, -1):
        twice = 1.0 + z * twice * (1.0 / k)
    phi_2 = 0.5 * twice
    phi_1 = 1.0 + z * phi_2
    phi_0 = 1.0 + z * phi_1
    for i in range(int(highest(halvings))):
        grown, done = 1.0 + phi_0, float(i)
        phi_2 = where_less(done, halvings, 0.25 * (grown * phi_2 + phi_1), phi_2)
        phi_1 = where_less(done, halvings, 0.5 * (grown * phi_1), phi_1)
        phi_0 = where_less(done, halvings, phi_0 * phi_0, phi_0)
    return phi_0, phi_1, phi_2


@jit
def pole_of_mode(s, d):
    """z = -d/2 + J."""
    return new_quadratic(-0.5 * d, 1.0 + 0.0 * d, 0.25 * d * d - s)


@jit
def exact_step(s, d, quantity, step):
    """e, c and g phi_2."""
    z = pole_of_mode(s, d)
    phi_0, phi_1, phi_2 = exponentials(z, the_value(s), the_value(d))
    w = z * phi_1
    if quantity == RELATIVE_DISPLACEMENT:
        return phi_0, (0.0 - step * step) * (phi_1 + phi_2 * w), (step * step) * phi_2
    if quantity == RELATIVE_VELOCITY:
        return phi_0, (0.0 - step) * (phi_1 * w), step * (phi_1 - 1.0)
    return phi_0, -1.0 * (w * w), z * (phi_1 - 1.0)
