"""Inter-storey drifts and base shears of `simulate`, against hand sums and the balance of forces."""

import numpy as np
import pytest
from scipy import sparse

from pymc_features import (
    DuffingChain,
    HystereticChain,
    LinearStructure,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    simulate,
)
from pymc_features.simulators import HISTORIES
from pymc_features.structures import spring_forces
from support.refusals import refusals
from support.straight import Loading
from support.structures import noise_record, peak_error

MASS = np.array([3.0, 2.0, 1.0, 2.5])
STIFFNESS = np.array([900.0, 700.0, 800.0, 500.0])
RAYLEIGH = RayleighDamping(0.3, 2e-3)
SHAKE = noise_record(120, scale=3.0)
CHAINS = (
    SpringMassChain(MASS, STIFFNESS, RAYLEIGH),
    SpringMassChain(1.5, STIFFNESS, ModalDamping([0.02, 0.05, 0.1, 0.0])),
    HystereticChain(MASS, STIFFNESS, RAYLEIGH, yield_displacement=0.01, post_yield_ratio=0.1),
    DuffingChain(MASS, STIFFNESS, RAYLEIGH, cubic=1e6),
)


def by_hand(structure, quantity, **settings):
    """Drift and shear as they are defined, with a loop over the masses."""
    if quantity == "base_shear":
        mass = np.diag(structure.matrices()[0])
        acceleration = simulate(structure, SHAKE, **settings).values
        return sum(m * a for m, a in zip(mass, acceleration, strict=True))
    x = simulate(structure, SHAKE, quantity="relative_displacement", **settings).values
    return np.array([x[i] - (x[i - 1] if i > 0 else 0.0) for i in range(len(x))])


@pytest.mark.parametrize("structure", CHAINS, ids=lambda s: type(s).__name__)
@pytest.mark.parametrize("dt", [None, 0.01, 0.06])
def test_drift_and_shear_by_hand(structure, dt):
    settings = {"dt": dt, "n_modes": 2 if structure.is_linear and dt else None}
    drift = simulate(structure, SHAKE, quantity="inter_storey_drift", **settings)
    expected = by_hand(structure, "inter_storey_drift", **settings)
    assert peak_error(drift, expected) < 1e-12
    some = simulate(structure, SHAKE, quantity="inter_storey_drift", sensors=[2, 0], **settings)
    assert peak_error(some, expected[[2, 0]]) < 1e-12
    shear = simulate(structure, SHAKE, quantity="base_shear", **settings)
    assert peak_error(shear, by_hand(structure, "base_shear", **settings)) < 1e-12


def test_labels():
    drift = simulate(CHAINS[0], SHAKE, quantity="inter_storey_drift", sensors=[2, 0], dt=0.04)
    assert (drift.dims, drift.name) == (("storey", "time"), "inter_storey_drift")
    assert drift["storey"].values.tolist() == [2, 0]
    assert drift.attrs == {"units": "m", "record": "pulse"}
    assert drift["time"].values[-1] == pytest.approx(2.36)
    shear = simulate(CHAINS[0], SHAKE, quantity="base_shear")
    assert (shear.dims, shear.attrs["units"]) == (("time",), "N")
    assert {name: r.units for name, r in HISTORIES.items()} == {
        "absolute_acceleration": "m/s^2",
        "relative_acceleration": "m/s^2",
        "relative_velocity": "m/s",
        "relative_displacement": "m",
        "inter_storey_drift": "m",
        "base_shear": "N",
        "restoring_force": "N",
    }


def test_nonlinear_drifts_are_those_of_the_springs():
    for structure in CHAINS[2:]:
        drift = simulate(structure, SHAKE, quantity="inter_storey_drift")
        assert peak_error(drift, spring_forces(structure, SHAKE)["drift"]) < 1e-12


@pytest.mark.parametrize(("kind", "n_modes"), [(np.asarray, 1), (sparse.csc_array, None)])
def test_shear_of_a_chain_by_its_matrices(kind, n_modes):
    for chain in CHAINS[:2]:
        mass, damping, stiffness = chain.matrices()
        expected = simulate(chain, SHAKE, quantity="base_shear", dt=0.01, n_modes=n_modes)
        for given in (chain.damping, damping):
            linear = LinearStructure(kind(mass), stiffness=kind(stiffness), damping=given)
            found = simulate(linear, SHAKE, quantity="base_shear", dt=0.01, n_modes=n_modes)
            assert found.dims == ("time",)
            assert peak_error(found, expected) < 1e-12


def coupled(influence=None):
    """Four degrees of freedom with full matrices, whose modes a dashpot couples."""
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(2, 4, 4))
    mass, stiffness = (f @ f.T + np.eye(4) for f in factors)
    return LinearStructure(
        mass, stiffness=200.0 * stiffness, damping=np.diag([2.0, 0.0, 0.3, 0.0]), influence=influence
    )


@pytest.mark.parametrize("damping", ["coupled", "classical"])
def test_balance_of_forces(damping):
    """Shear + influence' (C v + K x) = 0 under one base, two supports, and forces; all from `simulate`."""
    rng = np.random.default_rng(4)
    share = rng.uniform(0.2, 0.8, (4, 2))
    two = Loading(rng.normal(size=(2, 100)), 0.02)
    forces = Loading(rng.normal(size=(3, 100)), 0.02, kind="force", matrix=rng.normal(size=(4, 3)))
    nodal = Loading(rng.normal(size=(4, 100)), 0.02, kind="force")
    cases = ((None, SHAKE), (share, two), (None, forces), (share, forces), (share, nodal))
    for influence, load in cases:
        structure = coupled(influence)
        if damping == "classical":
            mass, _, stiffness = structure.matrices()
            structure = LinearStructure(mass, stiffness=stiffness, damping=RAYLEIGH, influence=influence)
        _, matrix_c, matrix_k = structure.matrices()
        settings = {"dt": 0.01}
        v, x = (
            simulate(structure, load, quantity=f"relative_{q}", **settings).values
            for q in ("velocity", "displacement")
        )
        expected = -structure.influence.reshape(4, -1).T @ (matrix_c @ v + matrix_k @ x)
        found = simulate(structure, load, quantity="base_shear", **settings)
        if influence is None:
            assert found.dims == ("time",)
            expected = expected[0]
        else:
            assert found.dims == ("support", "time")
            assert found["support"].values.tolist() == [0, 1]
        assert peak_error(found, expected) < 1e-9


def test_slow_forces_go_to_the_ground():
    """Also with one mode kept: what the others would carry is not lost."""
    ramp = Loading(
        np.outer([1.0, -3.0, 5.0, 2.0], np.clip(np.arange(400) / 300.0, 0.0, 1.0)), 1.0, kind="force"
    )
    for n_modes in (None, 1):
        structure = LinearStructure(MASS, stiffness=CHAINS[0].matrices()[2], damping=RAYLEIGH)
        shear = simulate(structure, ramp, quantity="base_shear", n_modes=n_modes)
        assert float(shear[-1]) == pytest.approx(-5.0, rel=1e-6)


REFUSED_VALUES = {  # what is said: what is given
    "`quantity` must be one of .*, base_shear for a LinearStructure, got 'inter_storey_drift'. "
    ".* are no storeys: pass 'relative_displacement' and outputs=S": (
        coupled(),
        {"quantity": "inter_storey_drift"},
    ),
    "`quantity` must be one of .*base_shear, got 'shear'": (CHAINS[0], {"quantity": "shear"}),
    r"`sensors` must be left out for the base shear, got \[1\]. It is a sum": (
        CHAINS[2],
        {"quantity": "base_shear", "sensors": [1]},
    ),
    "`outputs` must be left out for 'inter_storey_drift', got an array. .* combine 'relative_disp": (
        CHAINS[0],
        {"quantity": "inter_storey_drift", "outputs": np.eye(4)},
    ),
    "`outputs` must be left out for 'base_shear', got an array. .* combine 'absolute_acc": (
        coupled(),
        {"quantity": "base_shear", "outputs": np.eye(4)},
    ),
    r"`matrix` of the forces must have shape \(4, 3\), got none": (
        coupled(),
        {"quantity": "base_shear", "record": Loading(np.ones((3, 9)), 0.1, kind="force")},
    ),
}


@refusals("structure arguments", REFUSED_VALUES)
def test_refusals(structure, arguments, match):
    with pytest.raises(ValueError, match=match):
        simulate(structure, **({"record": SHAKE} | arguments))
