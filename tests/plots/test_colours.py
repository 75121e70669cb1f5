"""Readers with a colour vision deficiency tell the likelihoods of a figure apart."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from pymc_features.likelihoods import LIKELIHOODS

# Machado, Oliveira & Fernandes, IEEE TVCG 15 (2009) 1291-1298, severity 1: linear RGB as it is seen
SEEN = {
    "all": np.eye(3),
    "no red": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "no green": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}
# Ottosson (2020): linear RGB to the cones, and their cube roots to OKLab, in which equal distances look equal
CONES = [
    [0.4122214708, 0.5363325363, 0.0514459929],
    [0.2119034982, 0.6806995451, 0.1073969566],
    [0.0883024619, 0.2817188376, 0.6299787005],
]
OKLAB = [
    [0.2104542553, 0.7936177850, -0.0040720468],
    [1.9779984951, -2.4285922050, 0.4505937099],
    [0.0259040371, 0.7827717662, -0.8086757660],
]
LEAST = 0.07  # black and white are 1 apart


def distance(one: str, other: str, seen) -> float:
    """How far two colours look apart."""
    rgb = np.array([to_rgb(one), to_rgb(other)]).T
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    cones = np.array(CONES) @ np.clip(np.array(seen) @ linear, 0.0, 1.0)
    return float(np.linalg.norm(np.array(OKLAB) @ np.cbrt(cones) @ [1.0, -1.0]))


@pytest.mark.parametrize("seen", SEEN.values(), ids=SEEN)
def test_likelihoods_are_told_apart(seen):
    colours = {name: entry.colour for name, entry in LIKELIHOODS.items()}
    near = {
        pair: distance(*(colours[name] for name in pair), seen) for pair in itertools.combinations(colours, 2)
    }
    assert min(near.values()) > LEAST, {pair: d for pair, d in near.items() if d <= LEAST}


def test_the_default_colours_of_matplotlib_are_not():
    """Negative control: orange and green without the cones for red."""
    assert distance("C1", "C2", SEEN["no red"]) < 0.5 * LEAST
    assert distance("black", "white", SEEN["all"]) == pytest.approx(1.0, abs=1e-3)
