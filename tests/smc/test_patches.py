"""Parts of a proposal around draws that outweigh the rest."""

import numpy as np
import pytest
from scipy import stats

from pymc_features.smc.proposals.fitted import FittedProposal
from pymc_features.smc.proposals.patches import MOST_PATCHES, patched
from pymc_features.smc.proposals.proposal import StudentMixture, StudentT

SPUR, SHARE = stats.multivariate_normal([6.0, 3.0], [[0.16, 0.12], [0.12, 0.36]]), 0.05


def target(x):
    """Log-density of a standard normal distribution with a spur, of 5 %."""
    bulk = stats.multivariate_normal([0.0, 0.0]).logpdf(x)
    return np.logaddexp(np.log1p(-SHARE) + bulk, np.log(SHARE) + SPUR.logpdf(x))


def wide():
    """What fits the bulk, and draws that have come across the spur now and then."""
    part = StudentMixture([StudentT(np.zeros(2), 1.1 * np.eye(2), 6.0)], np.ones(1))
    safeguard = StudentMixture([StudentT(np.zeros(2), 4.0 * np.eye(2), 6.0)], np.ones(1))
    return FittedProposal([part, safeguard], np.array([0.8, 0.2]))


def weighted(proposal, n=4000, seed=0):
    """Draws and their shares in the target."""
    x = proposal.draw(n, np.random.default_rng(seed))
    w = np.exp(target(x) - proposal.log_density(x))
    return x, w / w.sum(), w


def test_they_cover_what_draws_have_hardly_met():
    """The heaviest draw of 4000 stands for a fifth of what it did; the density is still one, to 4 errors."""
    proposal = wide()
    x, shares, _ = weighted(proposal)
    points = x[np.random.default_rng(1).choice(len(x), 800, p=shares)]
    better = patched(proposal, points, x, shares)
    assert len(proposal.components) < len(better.components) <= len(proposal.components) + MOST_PATCHES
    assert better.weights.sum() == pytest.approx(1.0)
    assert better.components[0] is proposal.components[0]
    assert better.components[-1] is proposal.components[-1]
    _, new, w = weighted(better, seed=2)
    assert new.max() < 0.2 * shares.max()
    assert abs(w.mean() - 1.0) < 4.0 * w.std() / np.sqrt(len(w)) < 0.1


def test_none_where_no_draw_is_heavy():
    proposal = wide()
    x = proposal.draw(500, np.random.default_rng(0))
    assert patched(proposal, x, x, np.full(500, 1.0 / 500)) is proposal


def test_one_draw_that_stands_for_all():
    """Its part has the size of the draws next to it, not none."""
    proposal = wide()
    x = proposal.draw(500, np.random.default_rng(0))
    shares = np.zeros(500)
    shares[7] = 1.0
    part = patched(proposal, x, x, shares).components[1]
    assert np.linalg.norm(part.location - x[7]) < 3.0
    assert (np.diag(part.factor) > 0.05).all()
