"""The law of Bouc, Wen, Baber and Noori along a branch on which the displacement goes one way.

With the displacement d, the dimensionless internal variable z, at rest zero, and the dimensionless energy e,

    f = a k d + (1 - a) k d_y z,
    d_y z' = d' h(z, e) {1 - nu(e) |z|^n [gamma + beta sign(d' z)]} / eta(e),      d_y e' = z d',

where k is the initial stiffness, d_y the yield displacement and a the post-yield ratio; the hysteretic part
has taken up the energy (1 - a) k d_y^2 e. Strength and stiffness degrade with it, and loops are pinched:

    nu = 1 + delta_nu e,    eta = 1 + delta_eta e,
    h = 1 - zeta_1 exp{-[z sign(d') - q z_u]^2 / zeta_2^2},    z_u = [nu (beta + gamma)]^(-1/n),
    zeta_1 = zeta_s (1 - exp(-p e)),    zeta_2 = (psi + delta_psi e) (lambda + zeta_1).

Nothing here depends on time. With x the way gone since the last reversal, over d_y, and w = z sign(d'), one
branch obeys

    dw/dx = h (1 - nu |w|^n c) / eta,    de/dx = w,    c = gamma + beta sign(w).

w grows along it, and passes zero once at most: there c jumps and |w|^n has a kink.

References
----------
T. T. Baber & Y.-K. Wen, J. Eng. Mech. Div. ASCE 107 (1981) 1069-1087 (degradation). T. T. Baber & M. N.
Noori, J. Eng. Mech. 111 (1985) 1010-1026 and J. Vib. Acoust. 108 (1986) 411-420 (pinching). G. C. Foliente,
J. Struct. Eng. 121 (1995) 1013-1022: h, zeta_1, zeta_2 and z_u as above, here with A = 1, which no data can
tell from the other parameters (F. Ma et al., J. Appl. Mech. 71 (2004) 342-349).
"""

from typing import NamedTuple

import numpy as np

from pymc_features.simulators.compiled.jit import jit

NAMES = (
    "stiffness",
    "yield_displacement",
    "post_yield_ratio",
    "sharpness",
    "beta",
    "gamma",
    "strength_degradation",
    "stiffness_degradation",
    "slip",
    "slip_rate",
    "initiation",
    "spread",
    "spread_rate",
    "severity",
)
N_PARAMETERS = len(NAMES)
STIFFNESS, REACH, RATIO, SHARPNESS, BETA, GAMMA, D_NU, D_ETA, SLIP, SLIP_RATE, Q, PSI, D_PSI, SEVERITY = (
    range(N_PARAMETERS)
)


class SpecimenParameters(NamedTuple):
    """What a specimen is.

    Attributes
    ----------
    law : array (14,), of a population (p, 14)
        In the order of `NAMES`: k [N/m], d_y [m], a, n, beta, gamma, delta_nu, delta_eta, zeta_s, p, q, psi,
        delta_psi and lambda [-].
    """

    law: np.ndarray


@jit
def is_specimen(law):
    """Whether loops dissipate and no denominator vanishes: -beta < gamma <= beta, degradation, h > 0."""
    spring = 0.0 < law[STIFFNESS] < np.inf and 0.0 < law[REACH] < np.inf and 0.0 <= law[RATIO] <= 1.0
    shape = 1.0 <= law[SHARPNESS] < np.inf and 0.0 < law[BETA] < np.inf
    loops = shape and -law[BETA] < law[GAMMA] <= law[BETA]
    for i in (D_NU, D_ETA, SLIP, SLIP_RATE, Q, D_PSI):
        loops = loops and 0.0 <= law[i] < np.inf
    pinched = law[SLIP] < 1.0 and 0.0 < law[PSI] < np.inf and 0.0 < law[SEVERITY] < np.inf
    return spring and loops and pinched


@jit
def rate(law, w, e, sign, partials):
    """dw/dx on the side of w that `sign` names; its derivatives by w, e and the parameters if asked for.

    Parameters
    ----------
    partials : array (16,) or (0,)
        Written: by w, by e, then by each parameter in the order of `NAMES`, zero for the first three.
    """
    n, total, wants = law[SHARPNESS], law[BETA] + law[GAMMA], partials.size > 0
    nu, eta = 1.0 + law[D_NU] * e, 1.0 + law[D_ETA] * e
    size, c = abs(w), law[GAMMA] + law[BETA] * sign
    if n == 2.0:
        steep = size
    elif n == 1.0:
        steep = 1.0
    else:
        steep = size ** (n - 1.0)
    power = steep * size
    bracket = 1.0 - nu * power * c
    if law[SLIP] == 0.0 and not wants:
        return bracket / eta
    decay = np.exp(-law[SLIP_RATE] * e)
    zeta_1 = law[SLIP] * (1.0 - decay)
    wide, severe = law[PSI] + law[D_PSI] * e, law[SEVERITY] + zeta_1
    zeta_2 = wide * severe
    z_u = (nu * total) ** (-1.0 / n)
    u = (w - law[Q] * z_u) / zeta_2
    bell = np.exp(-u * u)
    h = 1.0 - zeta_1 * bell
    value = h * bracket / eta
    if wants:
        partials[:] = 0.0
        by, by_bracket = partials[2:], -h / eta  # of nu |w|^n c
        by_zeta_1, by_u = -bell * bracket / eta, 2.0 * zeta_1 * bell * u * bracket / eta
        by_zeta_2, by_z_u = -by_u * u / zeta_2, -by_u * law[Q] / zeta_2
        by_zeta_1 += by_zeta_2 * wide
        by_nu = by_bracket * power * c - by_z_u * z_u / (n * nu)
        by_slip_and_decay = by_zeta_1 * law[SLIP] * decay
        partials[0] = by_bracket * nu * n * steep * sign * c + by_u / zeta_2
        partials[1] = by_nu * law[D_NU] - value * law[D_ETA] / eta
        partials[1] += by_slip_and_decay * law[SLIP_RATE] + by_zeta_2 * severe * law[D_PSI]
        if size > 0.0:
            by[SHARPNESS] = by_bracket * nu * power * np.log(size) * c
        by[SHARPNESS] += by_z_u * z_u * np.log(nu * total) / (n * n)
        by[GAMMA] = by_bracket * nu * power - by_z_u * z_u / (n * total)
        by[BETA] = by_bracket * nu * power * sign - by_z_u * z_u / (n * total)
        by[D_NU], by[D_ETA] = by_nu * e, -value * e / eta
        by[SLIP], by[SLIP_RATE] = by_zeta_1 * (1.0 - decay), by_slip_and_decay * e
        by[Q] = -by_u * z_u / zeta_2
        by[PSI], by[D_PSI] = by_zeta_2 * severe, by_zeta_2 * severe * e
        by[SEVERITY] = by_zeta_2 * wide
    return value
