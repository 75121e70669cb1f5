"""Compile ahead what most models need, once for a machine and a version; each finished step is kept on disk.

Every step declares a small model of one family of structures and samples it, so that its kernels and those
of the samplers are there: responses, misfits of populations, gradients, histories of draws, modes.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import pymc as pm

import pymc_features as pmf

STOREYS, DRAWS = 10, 100
YIELDING = {"yield_displacement": 0.01, "post_yield_ratio": 0.1}
RATIO, RAYLEIGH = pmf.ModalDamping(0.02), pmf.RayleighDamping(0.1, 1e-4)


def chain(cls, damping, theta, **more):
    """A chain of the family `cls` whose first spring is uncertain."""
    whole = cls(mass=np.ones(STOREYS), stiffness=1800.0, damping=damping, **more)
    return whole.scale_stiffness(theta, springs=[0])


FAMILIES = {
    "chains with damping ratios": partial(chain, pmf.SpringMassChain, RATIO),
    "chains with Rayleigh damping": partial(chain, pmf.SpringMassChain, RAYLEIGH),
    "structures by their matrices": lambda theta: chain(pmf.SpringMassChain, RAYLEIGH, theta).as_linear(),
    "chains that yield": partial(chain, pmf.HystereticChain, RAYLEIGH, **YIELDING),
}


def sample_history(structure: Callable) -> None:
    """Sample a model of measured accelerations, and predict with it."""
    record = pmf.synthetic_earthquake(4.0, 0.02, random_seed=1, pga=3.0)
    measured = pmf.simulate(structure(1.0), record).values
    with pm.Model():
        theta, sigma = pm.Uniform("theta", 0.5, 1.5), pm.HalfNormal("sigma", 1.0)
        mu = pmf.response(structure(theta), record)
        pmf.ExpFeature("y", mu=mu, sigma=sigma, observed=measured + 0.1 * measured.std())
        idata = pmf.sample(DRAWS, chains=2, cores=1, random_seed=1, check=None, progressbar=False)
    pmf.prediction.posterior_response(idata, structure, record, draws=DRAWS, random_seed=1)


def sample_modes() -> None:
    """Sample a model of identified modes."""
    structure = FAMILIES["chains with damping ratios"]
    found = structure(1.0).modes()
    data = pmf.modal.ModalData(found.natural_frequencies, shapes=found.mode_shapes.T, channels=range(STOREYS))
    with pm.Model():
        theta = pm.Uniform("theta", 0.5, 1.5)
        modes = pmf.modes(structure(theta), STOREYS)
        pmf.ModalFeature("modes", modes, observed=data, sigma_f=0.01, sigma_phi=0.05)
        pmf.sample(DRAWS, chains=2, cores=1, random_seed=1, check=None, progressbar=False)


STEPS = {name: partial(sample_history, structure) for name, structure in FAMILIES.items()}
STEPS["identified modes"] = sample_modes


def warm_up(progress: Callable[[str, int, int], None] | None = None) -> None:
    """Compile what is not compiled yet.

    Parameters
    ----------
    progress : callable (str, int, int), optional
        Called with what is in work, the number of steps finished, and the number in all.
    """
    tell = progress or (lambda part, done, total: None)
    for done, (name, step) in enumerate(STEPS.items()):
        tell(name, done, len(STEPS))
        step()
    tell("finished", len(STEPS), len(STEPS))
