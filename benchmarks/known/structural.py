"""Structural posteriors of 2 to 41 parameters: NORM, TN and EXP, wide and narrow priors.

The ten-storey chain of the source with Rayleigh damping under a synthetic earthquake of ten seconds, all
floors measured with 10 % noise. Springs share a factor in groups (d = 2 ... 5) or have one each; d = 22 adds
the two factors of the damping and a sigma for each sensor; d = 41 is a chain of forty storeys with twenty
sensors. Wide priors are uniform and leave several modes, narrow ones are log-normal.
"""

from functools import cache

import numpy as np
import pymc as pm

import pymc_features as pmf

LIKELIHOODS = ("NORM", "TN", "EXP")
PRIORS = ("wide", "narrow")
STIFFNESS, TALL_STIFFNESS = 1800.0, 4 * 1800.0  # N/m, masses of 1 kg
ALPHA, BETA = 0.2265, 6.7515e-4  # 1/s, s
NOISE = 0.1  # over the standard deviation of each channel

# springs that share a factor; the others are known
GROUPS = {
    2: [range(3)],
    3: [range(3), range(3, 6)],
    4: [range(3), range(3, 6), range(6, 10)],
    5: [range(2), range(2, 4), range(4, 6), range(6, 8)],
}
DIMENSIONS = (*GROUPS, 11, 22, 41)
NAMES = tuple(f"{like}-{d}-{prior}" for d in DIMENSIONS for like in LIKELIHOODS for prior in PRIORS)


@cache
def record():
    """The ground motion."""
    return pmf.paper.with_straight_lines(pmf.synthetic_earthquake(10.0, 0.02, random_seed=1, pga=3.0))


def storeys(d):
    """Number of storeys."""
    return 40 if d == 41 else 10


def sensors(d):
    """Floors that are measured."""
    return list(range(1, 40, 2)) if d == 41 else list(range(10))


def springs(d):
    """Springs of each factor."""
    return GROUPS.get(d) or [[i] for i in range(storeys(d))]


def structure(d, theta, damping):
    """The chain with the factors theta of its springs."""
    n = storeys(d)
    stiffness = TALL_STIFFNESS if n == 40 else STIFFNESS
    chain = pmf.SpringMassChain(mass=np.ones(n), stiffness=stiffness, damping=damping)
    if d not in GROUPS:
        return chain.scale_stiffness(theta, springs=list(range(n)))
    for i, group in enumerate(springs(d)):
        chain = chain.scale_stiffness(theta[i], springs=list(group))
    return chain


@cache
def measured(d):
    """Data (sensor, time): theta = 1, and noise."""
    damping = pmf.RayleighDamping(alpha=ALPHA, beta=BETA)
    truth = structure(d, np.ones(len(springs(d))), damping)
    response = pmf.simulate(truth, record(), sensors=sensors(d)).values
    noise = np.random.default_rng(2).standard_normal(response.shape)
    return response + NOISE * response.std(axis=1, keepdims=True) * noise


def priors(d, prior):
    """Random variables theta, sigma, alpha, beta; the last two are numbers but for d = 22."""
    shape = 10 if d == 22 else ()
    factors = len(springs(d))
    if prior == "wide":
        theta = pm.Uniform("theta", 0.5, 1.5, shape=factors)
        sigma = pm.Uniform("sigma", 0.0, 2.0, shape=shape)
        if d == 22:
            return theta, sigma, pm.Uniform("alpha", 0.0, 1.0), pm.Uniform("beta", 0.0, 3e-3)
    else:
        theta = pm.LogNormal("theta", 0.0, 0.1, shape=factors)
        sigma = pm.LogNormal("sigma", np.log(0.2), 0.5, shape=shape)
        if d == 22:
            alpha = pm.LogNormal("alpha", np.log(0.2265), 0.3)
            return theta, sigma, alpha, pm.LogNormal("beta", np.log(6.75e-4), 0.3)
    return theta, sigma, ALPHA, BETA


def declare(name):
    """The PyMC model of a name such as EXP-11-wide."""
    like, d, prior = name.split("-")
    d = int(d)
    with pm.Model() as model:
        theta, sigma, alpha, beta = priors(d, prior)
        damping = pmf.RayleighDamping(alpha=alpha, beta=beta)
        mu = pmf.response(structure(d, theta, damping), record(), sensors=sensors(d))
        if like == "NORM":
            pm.Normal("y", mu=mu, sigma=sigma[:, None] if d == 22 else sigma, observed=measured(d))
        else:
            feature = {"TN": pmf.TruncNormalFeature, "EXP": pmf.ExpFeature}[like]
            feature("y", mu=mu, sigma=sigma, observed=measured(d))
    return model
