"""Linear structures by lists of dense matrices, and their responses without the modes of the package."""

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from pymc_features.algebra import AffineMatrix, common_pattern
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.oscillators.arguments import NO_DIRECT
from support.reference import first_order_hold, interpolated

LINEAR = FAMILIES["linear"]


class Case:
    """A structure by lists of dense matrices, what acts on it and what is asked; M, C, K: A_0, A_1, ..."""

    def __init__(self, mass, damping, stiffness, theta, *, influence=None, forces=None, **asked):
        self.mass, self.damping, self.stiffness, self.theta = mass, damping, stiffness, np.array(theta)
        n = len(mass[0])
        rng = np.random.default_rng(n)
        given = influence if forces is None else forces
        self.influence = np.zeros(given.shape) if influence is None else influence
        self.forces = np.zeros(given.shape) if forces is None else forces
        self.inputs = rng.normal(size=(given.shape[1], asked.get("n_times", 120)))
        self.dt, self.n_modes = 0.03, asked.get("n_modes", n)
        self.substeps, self.stride = asked.get("grid", (1, 1))
        self.sensors, self.quantity = rng.normal(size=(3, n)), asked.get("quantity", 0)
        self.rayleigh = np.zeros(2) if damping else np.array([0.3, 2e-3])
        self.ratios = np.full(n, asked.get("ratio", 0.0))
        self.is_sparse = asked.get("is_sparse", False)

    @property
    def parameters(self):
        return self.theta, self.rayleigh, self.ratios

    @property
    def rest(self):
        """Constants, inputs and what is asked, as the kernels take them."""
        stacks, pattern = self.mass, (np.zeros(0, dtype=int), np.zeros(0, dtype=int))
        n, lists = len(self.mass[0]), (self.mass, self.damping, self.stiffness)
        if self.is_sparse:
            lists = [[sparse.csc_array(a) for a in matrices] for matrices in lists]
            pattern = common_pattern([a for matrices in lists for a in matrices])
            none = np.zeros((0, pattern[0].size))
            stacks = [AffineMatrix(a[0], a[1:], pattern).stack if a else none for a in lists]
        else:
            stacks = [np.array(a).reshape(len(a), n * n) for a in lists]
        return (
            *(*stacks, *pattern, self.influence, self.forces, self.inputs, self.dt),
            *(self.substeps, self.stride, NO_DIRECT, self.sensors, self.n_modes, self.quantity),
        )

    @property
    def arguments(self):
        return *self.parameters, *self.rest

    def named(self):
        """The same by name."""
        return dict(zip([*LINEAR.inputs, "quantity"], self.arguments, strict=True))

    def arguments_with(self, **changes):
        """The same, some of them others."""
        return tuple((self.named() | changes).values())

    def grouped(self):
        """The same as the kernels take them."""
        return Arguments(*LINEAR.assemble(self.arguments[:-1], self.quantity))

    def reference(self, flat):
        """The response (s, u) without our modes; analytic in the parameters but for ratios and truncation."""
        p, n = self.theta.size, len(self.mass[0])
        theta, rayleigh, ratios = flat[:p], flat[p : p + 2], flat[p + 2 :]
        mass, stiffness = (
            a[0] + sum((t * b for t, b in zip(theta, a[1:], strict=False)), 0.0)
            for a in (self.mass, self.stiffness)
        )
        keep = np.eye(n)
        if self.damping:
            c = self.damping
            damping = c[0] + sum((t * b for t, b in zip(theta, c[1:], strict=False)), 0.0)
        else:
            damping = rayleigh[0] * mass + rayleigh[1] * stiffness
        if self.n_modes < n or ratios.any():
            values, shapes = eigh(stiffness, mass)
            moved = mass @ shapes
            damping = damping + moved * (2.0 * ratios * np.sqrt(np.maximum(values, 0.0))) @ moved.T
            keep = shapes[:, : self.n_modes]
        load = keep.T @ (self.forces - mass @ self.influence)
        reduced = [keep.T @ a @ keep for a in (mass, damping, stiffness)]
        inputs, step = interpolated(self.inputs, self.substeps), self.dt / self.substeps
        system = [np.linalg.solve(reduced[0], a) for a in (*reduced[1:], load)]
        x, v, a = (keep @ history for history in first_order_hold(*system, inputs, step, self.stride))
        return self.sensors @ (a + self.influence @ inputs[:, :: self.stride], a, v, x)[self.quantity]

    def derivatives(self):
        """Directions (k, k), one for each parameter, and the derivatives of the reference, (k, s, u)."""
        point = np.concatenate(self.parameters)
        sizes = np.ones(self.theta.size), [0.1, 1e-3], np.full(self.ratios.size, 0.01)
        directions = np.diag(np.concatenate(sizes))
        if self.damping:
            directions = directions[: self.theta.size]
        elif not self.ratios.any():
            directions = directions[: self.theta.size + 2]
        if self.n_modes == len(self.mass[0]) and not self.ratios.any():
            return directions, np.array([self.reference(point + 1e-30j * d).imag / 1e-30 for d in directions])
        step, f = 2e-3, self.reference
        return directions, np.array(
            [
                8.0 * (f(point + step * d) - f(point - step * d))
                - (f(point + 2 * step * d) - f(point - 2 * step * d))
                for d in directions
            ]
        ) / (12.0 * step)


def split(flat, like):
    return np.split(flat, np.cumsum([a.size for a in like])[:-1])


def definite(rng, n, scale):
    mixing = rng.normal(size=(n, n))
    return scale * mixing @ mixing.T / n


def springs(n, k, *, free=False):
    """K of a chain, fixed at the base or floating."""
    drifts = np.diff(np.eye(n), axis=0) if free else np.diff(np.eye(n), axis=0, prepend=0.0)
    return drifts.T @ (np.broadcast_to(k, len(drifts))[:, None] * drifts)


def random_case(seed, n, *, coupled=False, free=False, constant_mass=False, d=1, forces=False, **asked):
    """Random M and C, random springs, three parameters."""
    rng = np.random.default_rng(seed)
    zero = np.zeros((n, n))
    mass = [definite(rng, n, 1.0) + np.eye(n), definite(rng, n, 0.2), zero, definite(rng, n, 0.1)]
    count = n - 1 if free else n
    stiffness = [springs(n, rng.uniform(50.0, 400.0, count), free=free)]
    stiffness += [springs(n, rng.uniform(0.0, 80.0, count), free=free) for _ in range(3)]
    damping = [definite(rng, n, 0.5), definite(rng, n, 0.1), definite(rng, n, 0.3), zero] if coupled else []
    if coupled:
        skew = rng.normal(size=(n, n))
        damping[1] += 0.1 * (skew - skew.T)  # gyroscopic
    load = {"forces" if forces else "influence": rng.normal(size=(n, d))}
    mass = mass[:1] if constant_mass else mass
    return Case(mass, damping, stiffness, [1.0, 0.5, 0.7], **load, **asked)


def twin_towers(coupled):
    """Both directions of a symmetric tower: frequencies in pairs, which the last parameter couples."""
    one, zero = springs(3, [300.0, 200.0, 100.0]), np.zeros((3, 3))
    stiffness = np.block([[one, zero], [zero, one]])
    link = 20.0 * np.block([[zero, np.eye(3)], [np.eye(3), zero]])
    mass = np.diag([2.0, 1.0, 1.0, 2.0, 1.0, 1.0])
    extra = np.diag([0.3, 0.0, 0.1, 0.0, 0.2, 0.0])
    damping = [0.4 * mass, 0.0 * mass, 2e-3 * stiffness, 0.1 * extra] if coupled else []
    influence = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])[:, None]
    masses, stiffnesses = (
        [mass, extra, 0.0 * mass, 0.0 * mass],
        [stiffness, 0.0 * link, 0.1 * stiffness, link],
    )
    return Case(masses, damping, stiffnesses, [0.0, 0.0, 0.0], influence=influence)


def twin_rafts(coupled):
    """Two floating chains: two modes of frequency zero; the parameters hold the chains and link them."""
    one = springs(4, 200.0, free=True)
    link = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([0.0, 1.0, 0.0, 2.0]))
    mass, holds = np.diag([2.0, 1.0, 1.0, 1.5, 1.0, 1.0, 3.0, 1.0]), np.diag([1.0, *[0.0] * 7])
    damping = [np.kron(np.eye(2), 0.02 * one), 0.1 * holds, 0.1 * link] if coupled else []
    stiffness = [np.kron(np.eye(2), one), holds, link]
    forces = np.arange(1.0, 9.0)[:, None]
    return Case([mass, 0.1 * mass, 0.0 * mass], damping, stiffness, [0.0, 0.0], forces=forces, quantity=3)


def proportional_matrix():
    """C_0 that the modes diagonalise at theta = 0, and a dashpot by which its derivative couples them."""
    case = random_case(8, 4, coupled=True, constant_mass=True)
    dashpot = np.diag([0.0, 0.0, 0.0, 1.0])
    case.damping = [0.3 * case.mass[0] + 2e-3 * case.stiffness[0], dashpot, 0.0 * dashpot, 0.0 * dashpot]
    case.theta = np.zeros(3)
    return case


# name: case, and what its reference is good for
CASES = {}
for _coupled in (False, True):
    _tag = "coupled" if _coupled else "classical"
    for _q in range(4):
        CASES[f"{_tag}, quantity {_q}"] = random_case(_q, 4, coupled=_coupled, quantity=_q), 1e-10
    CASES |= {
        f"{_tag}, two supports": (random_case(4, 4, coupled=_coupled, d=2), 1e-10),
        f"{_tag}, forces": (random_case(5, 4, coupled=_coupled, d=2, forces=True, quantity=1), 1e-10),
        f"{_tag}, sparse": (random_case(6, 9, coupled=_coupled, is_sparse=True), 1e-10),
        f"{_tag}, substeps": (random_case(7, 4, coupled=_coupled, grid=(3, 1)), 1e-10),
        f"{_tag}, stride": (random_case(7, 4, coupled=_coupled, grid=(1, 3), n_times=601), 1e-10),
        f"{_tag}, constant mass": (random_case(8, 4, coupled=_coupled, constant_mass=True), 1e-10),
        f"{_tag}, rigid body": (
            random_case(9, 4, coupled=_coupled, free=True, forces=True, quantity=3),
            1e-9,
        ),
        f"{_tag}, repeated": (twin_towers(_coupled), 1e-9),
        f"{_tag}, repeated rigid bodies": (twin_rafts(_coupled), 1e-9),
        f"{_tag}, truncated": (random_case(10, 6, coupled=_coupled, n_modes=2), 1e-7),
        f"{_tag}, truncated, sparse": (
            random_case(11, 9, coupled=_coupled, n_modes=3, d=2, is_sparse=True, quantity=1),
            1e-7,
        ),
        f"{_tag}, truncated, rigid, forces": (
            random_case(12, 9, coupled=_coupled, n_modes=3, free=True, forces=True, is_sparse=True),
            1e-7,
        ),
    }
CASES |= {
    "ratios": (random_case(13, 4, ratio=0.02, quantity=3), 1e-7),
    "ratios, truncated": (random_case(14, 6, ratio=0.02, n_modes=3, constant_mass=True), 1e-7),
    "proportional matrix": (proportional_matrix(), 1e-10),
}
