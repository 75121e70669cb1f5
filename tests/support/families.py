"""A structure of every family with two unknown factors, what shakes it, and data."""

import functools

import numpy as np
from scipy import sparse

from pymc_features import (
    AffineStructure,
    DuffingChain,
    HystereticChain,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    simulate,
)
from pymc_features.structures import CyclicTest, Degradation, HystereticSpecimen, Pinching
from support.straight import Loading, Record

RAYLEIGH = RayleighDamping(0.4, 2e-3)
K = np.array([[250.0, -150.0, 0.0], [-150.0, 270.0, -120.0], [0.0, -120.0, 120.0]])
LOWER = np.diag([100.0, 0.0, 0.0])  # what theta_0 scales
UPPER = np.array([[0.0, 0.0, 0.0], [0.0, 120.0, -120.0], [0.0, -120.0, 120.0]])  # and theta_1
C = 0.4 * np.eye(3) + 2e-3 * K + np.diag([0.0, 0.0, 1.5])  # a dashpot that couples the modes


def chain(x, kind, **springs):
    """Three masses whose springs 0 and 2 follow x (2,)."""
    nominal = kind(np.ones(3), [100.0, 150.0, 120.0], springs.pop("damping", RAYLEIGH), **springs)
    return nominal.scale_stiffness(x, springs=[0, 2])


def affine(x, damping=RAYLEIGH, kind=np.asarray, influence=None):
    rest = K - LOWER - UPPER
    terms = [kind(LOWER), kind(UPPER)]
    return AffineStructure(
        np.ones(3), stiffness=kind(rest), damping=damping, stiffness_terms=terms, influence=influence, theta=x
    )


def with_massless(x):
    """The same masses; degree of freedom 1 has none and lies between 0 and 2."""
    mass, rest = np.diag([1.0, 0.0, 1.5]), K - LOWER - UPPER
    return AffineStructure(mass, stiffness=rest, damping=RAYLEIGH, stiffness_terms=[LOWER, UPPER], theta=x)


def pulse(n=70, d=None):
    values = np.sin(0.35 * np.arange(n) ** 1.3) * np.exp(-0.03 * np.arange(n))
    if d is None:
        return Record(3.0 * values, dt=0.05)
    return np.array([values * (1.0 + i) + 0.2 * np.cos(0.9 * i + 0.3 * np.arange(n)) for i in range(d)])


SUPPORTS = np.array([[0.8, 0.2], [0.5, 0.5], [0.1, 0.9]])
CASES = {  # x -> structure, what shakes it
    "chain": (lambda x: chain(x, SpringMassChain), pulse()),
    "affine": (affine, pulse()),
    "coupled damping": (functools.partial(affine, damping=C), pulse()),
    "sparse": (functools.partial(affine, kind=sparse.csc_array), pulse()),
    "massless": (with_massless, pulse()),
    "modal damping": (functools.partial(affine, damping=ModalDamping(0.05)), pulse()),
    "two supports": (functools.partial(affine, influence=SUPPORTS), Loading(pulse(d=2), dt=0.05)),
    "forces": (affine, Loading(pulse(d=1), 0.05, kind="force", matrix=[[0.0], [1.0], [2.0]])),
    "hysteretic": (
        lambda x: chain(x, HystereticChain, yield_displacement=0.03, post_yield_ratio=0.2),
        pulse(),
    ),
    "duffing": (lambda x: chain(x, DuffingChain, cubic=3e4), pulse()),
}


def specimen(x):
    """Stiffness and yield displacement follow x (2,)."""
    return HystereticSpecimen(
        100.0 * x[0],
        yield_displacement=0.5 * x[1],
        post_yield_ratio=0.1,
        degradation=Degradation(0.02, 0.05),
        pinching=Pinching(0.6),
    )


CYCLIC = {"specimen": (specimen, CyclicTest(3.0 * pulse().acceleration, dt=0.05))}  # one force
MAIN = ("chain", "affine", "coupled damping", "hysteretic", "duffing")
TRUTH = np.array([1.0, 1.0])


@functools.cache
def measured(name):
    """Response of the truth, with noise."""
    build, record = (CASES | CYCLIC)[name]
    exact = simulate(build(TRUTH), record).values
    noise = np.random.default_rng(3).standard_normal(exact.shape)
    return exact + 0.1 * abs(exact).max() * noise
