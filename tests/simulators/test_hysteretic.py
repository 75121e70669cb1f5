"""Hysteretic and Duffing chains: a tight ODE solution, closed forms, linear limits, energy, and refusals."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from scipy.special import ellipj, ellipkinc

from pymc_features import (
    DuffingChain,
    HystereticChain,
    ModalDamping,
    RayleighDamping,
    SpringMassChain,
    response,
    simulate,
)
from pymc_features.simulators import QUANTITIES, Excitation
from pymc_features.simulators.families import NONLINEAR
from pymc_features.simulators.nonlinear.kernels import nonlinear_histories
from pymc_features.structures import integration_error, spring_forces
from support import straight
from support import structures as records
from support.kernels import flat_kernels
from support.refusals import refusals
from support.straight import Record
from support.structures import peak_error
from support.yielding import tight_solution

RAYLEIGH = RayleighDamping(0.2, 1e-3)


def bouc_wen(n=3, damping=RAYLEIGH, **changes):
    """A chain of 1.4 Hz and above whose springs yield under the records below."""
    springs = {"yield_displacement": 0.008, "post_yield_ratio": 0.1} | changes
    return HystereticChain(np.ones(n), np.linspace(400.0, 300.0, n), damping, **springs)


def duffing(n=3, damping=RAYLEIGH, cubic=1e6):
    """The same chain, hardening to several times its stiffness."""
    return DuffingChain(np.ones(n), np.linspace(400.0, 300.0, n), damping, cubic)


def noise_record(seed=0, n_times=60, scale=3.0, dt=0.02):
    return records.noise_record(n_times, dt, seed=seed, scale=scale)


def pulse_record(n_times=80):
    """Free vibration after a pulse."""
    return Record(np.r_[0.0, 8.0, 12.0, -4.0, np.zeros(n_times - 4)], 0.02)


def smooth_record(n_times=60):
    return Record(6.0 * np.sin(np.arange(n_times) * 0.16), 0.02)


def histories(structure, record, refine=1, quantities=(0, 3)):
    """Histories (quantity, sensor, time), with the steps divided by `refine`."""
    law, sensors = NONLINEAR[structure.family], np.arange(structure.n_dof)
    excitation = Excitation(record.acceleration, record.dt, 1, 1)
    return nonlinear_histories(law, structure.parameters(), excitation, sensors, quantities, refine)


def tower(n):
    """A long chain: for a while its upper springs do not move, but for rounding errors."""
    springs = {"yield_displacement": 0.005, "post_yield_ratio": 0.1, "beta": 0.6, "gamma": 0.4}
    return HystereticChain(np.ones(n), np.full(n, 18.0 * n**2), RayleighDamping(0.1, 0.002), **springs)


def growing_record(n_times):
    t = np.arange(n_times) * 0.02
    return Record(4.0 * np.sin(2.0 * np.pi * t) * t, 0.02)


CASES = {
    "bouc-wen": (bouc_wen(), noise_record()),
    "bouc-wen, one mass, free": (bouc_wen(1), pulse_record()),
    "n = 1": (bouc_wen(sharpness=1.0), noise_record(2)),
    "n = 3.5, modal damping": (
        bouc_wen(damping=ModalDamping([0.02, 0.05, 0.1]), sharpness=3.5),
        noise_record(3),
    ),
    "n = 20": (bouc_wen(1, sharpness=20.0), noise_record(4, 30)),
    "springs differ": (
        bouc_wen(
            yield_displacement=[0.004, 0.02, 0.01],
            post_yield_ratio=[0.0, 0.5, 0.05],
            sharpness=[2.0, 1.0, 6.0],
            beta=[0.8, 0.5, 0.6],
            gamma=[0.2, 0.4, 0.0],
        ),
        noise_record(5),
    ),
    "duffing": (duffing(), noise_record()),
    "duffing, one mass, free": (duffing(1, cubic=1e7), pulse_record()),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_against_a_tight_ode_solution(case):
    """1e-6 of the peak, in every quantity; and the springs are far from linear."""
    structure, record = CASES[case]
    exact = tight_solution(structure.parameters(), record.acceleration, record.dt)
    for quantity in QUANTITIES:
        assert peak_error(simulate(structure, record, quantity=quantity).values, exact[quantity]) < 1e-6
    linear = SpringMassChain(structure.mass, structure.stiffness, structure.damping)
    assert peak_error(simulate(linear, record), exact["absolute_acceleration"]) > 0.05
    start = {q: simulate(structure, Record([2.0, 1.0], 0.02), quantity=q).values[:, 0] for q in QUANTITIES}
    np.testing.assert_array_equal(start.pop("relative_acceleration"), -2.0)
    assert not any(values.any() for values in start.values())  # at rest at the first sample


def test_springs_that_do_not_move_yet():
    """Kinks of rounding errors do not stop the march, as they did in one record of fifty."""
    for seed in range(40):
        for n in (50, 60):
            assert np.isfinite(simulate(tower(n), noise_record(seed, 8)).values).all()
    structure, record = tower(20), growing_record(6)
    ours = simulate(structure, record, quantity="relative_displacement").values
    exact = tight_solution(structure.parameters(), record.acceleration, record.dt)
    assert peak_error(ours, exact["relative_displacement"]) < 1e-6


@pytest.mark.slow
def test_gradient_where_springs_do_not_move_yet():
    """Kinks of rounding errors have no derivative: central differences."""
    n = 33
    structure, record = tower(n), growing_record(50)
    kernels = flat_kernels("hysteretic")
    parameters = [np.array(p) for p in structure.parameters()]
    settings = (record.acceleration, 0.02, 1, 1, np.arange(n), n, 0)
    cotangent = np.random.default_rng(1).normal(size=(n, 50))

    def at(i, factor):
        moved = list(parameters)
        moved[i] = parameters[i] * (1.0 + factor)
        return (cotangent * kernels["response"](*moved, *settings)).sum()

    gradients = kernels["response_gradient"](*parameters, *settings, cotangent)
    h = 1e-5
    for i in (0, 1, 2, 4):
        expected = (8.0 * (at(i, h) - at(i, -h)) - at(i, 2 * h) + at(i, -2 * h)) / (12.0 * h)
        assert (gradients[i] * parameters[i]).sum() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("structure", [bouc_wen(10), duffing(10), bouc_wen(10, sharpness=1.0)])
def test_estimated_error_over_a_whole_record(record, structure):
    """Step doubling over El Centro: the accuracy of the docstrings; and the estimate is near the error."""
    estimate = integration_error(structure, record)
    assert 0.0 < estimate < 1e-6
    coarse, fine = histories(structure, record)[0], histories(structure, record, 6)[0]
    assert peak_error(coarse, fine) == pytest.approx(estimate, rel=0.2)


@pytest.mark.parametrize(
    "structure", [duffing(1), duffing(3), bouc_wen(1), bouc_wen(1, sharpness=4.0)], ids=str
)
def test_order_five(structure):
    """Errors shrink as the fifth power of the step, for the hysteretic spring across its kinks too."""
    record = smooth_record()
    exact = histories(structure, record, 32)
    steps = np.array([1, 2, 3])
    errors = [np.abs(histories(structure, record, r) - exact).max() for r in steps]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(("sharpness", "push"), [(1.0, 7.835), (2.0, 7.8185)])
def test_there_and_back_within_one_step(sharpness, push):
    """Velocity of one sign at both ends of a step and of the other for 2 ms between: 1e-6 if overlooked."""
    chain = HystereticChain(
        1.0,
        [50.0],
        ModalDamping(0.0),
        yield_displacement=0.01,
        post_yield_ratio=0.1,
        beta=0.5,
        gamma=0.4,
        sharpness=sharpness,
    )
    record = Record([0.0, -3.0, -3.0, -1.0, push, -4.0, -4.0, 0.0, 0.0], 0.02)
    velocity = simulate(chain, record, dt=0.02 / 64, quantity="relative_velocity").values[0]
    turned = np.flatnonzero(velocity < 0.0)
    assert 0.001 < 0.02 / 64 * np.sum(turned < 340) < 0.005, turned
    coarse, fine = (histories(chain, record, refine, quantities=[3]) for refine in (1, 32))
    assert peak_error(coarse, fine) < 1e-7


def test_duffing_free_vibration_is_a_jacobi_elliptic_cosine():
    """u" + k u + c u^3 = 0: u = A cn(W t + p | m) with W^2 = k + c A^2, m = c A^2 / (2 W^2)."""
    k, c = 300.0, 2e6
    chain = DuffingChain(1.0, [k], ModalDamping(0.0), c)
    record = pulse_record(100)
    u, v = (
        simulate(chain, record, quantity=f"relative_{q}").values[0, 4:] for q in ("displacement", "velocity")
    )
    energy = 0.5 * v[0] ** 2 + 0.5 * k * u[0] ** 2 + 0.25 * c * u[0] ** 4
    amplitude = np.sqrt((np.sqrt(k**2 + 4.0 * c * energy) - k) / c)
    rate = np.sqrt(k + c * amplitude**2)
    m = c * amplitude**2 / (2.0 * rate**2)
    phase = -np.sign(v[0]) * ellipkinc(np.arccos(u[0] / amplitude), m)
    exact = amplitude * ellipj(rate * np.arange(u.size) * record.dt + phase, m)[1]
    assert c * amplitude**2 > k  # far from linear
    assert peak_error(u, exact) < 1e-6


@pytest.mark.parametrize(
    ("n", "damping", "quantity"),
    [
        (4, RAYLEIGH, "absolute_acceleration"),
        (1, ModalDamping(0.05), "relative_acceleration"),
        (4, ModalDamping(0.0), "relative_displacement"),
        (4, ModalDamping(2.0), "relative_velocity"),
    ],
    ids=str,
)
def test_linear_limits(n, damping, quantity):
    """No post-yield loss, yielding out of reach, or no cubic part: the exact response of the linear chain."""
    record = noise_record(7, 100)
    limits = (
        bouc_wen(n, damping, post_yield_ratio=1.0),
        bouc_wen(n, damping, yield_displacement=1e6),
        duffing(n, damping, cubic=0.0),
    )
    exact = simulate(SpringMassChain(limits[0].mass, limits[0].stiffness, damping), record, quantity=quantity)
    for chain in limits:
        ours = simulate(chain, record, quantity=quantity)
        assert peak_error(ours.values, exact.values) < 1e-6
        assert ours.attrs == exact.attrs
        assert ours.coords.equals(exact.coords)


def slow_cycles():
    """Two cycles of 8 s, 150 N at their peaks on a mass of 1 kg with a period of 0.06 s."""
    return Record(-150.0 * np.sin(2.0 * np.pi * np.arange(801) * 0.02 / 8.0), 0.02)


def mass_on_spring(sharpness):
    law = {"yield_displacement": 0.01, "post_yield_ratio": 0.2, "sharpness": sharpness}
    return HystereticChain(1.0, [1e4], ModalDamping(0.2), **law)


def test_bilinear_limit_is_the_static_loop():
    """n = 60: force 100 N + 2000 N/m (d - 0.01 m), unloading at 10000 N/m, 8 J in each cycle."""
    loop = spring_forces(mass_on_spring(60.0), slow_cycles()).sel(spring=0)
    force, drift = loop["force"].values, loop["drift"].values
    assert drift.max() == pytest.approx(0.01 + 50.0 / 2000.0, rel=0.02)
    assert drift.min() == pytest.approx(-drift.max(), rel=0.02)
    plastic, clipped = 0.0, [0.0]
    for change in np.diff(drift):  # elastic-perfectly-plastic, by return mapping along the same drifts
        plastic = np.clip(plastic + change / 0.01, -1.0, 1.0)
        clipped.append(plastic)
    exact = 0.2 * 1e4 * drift + 0.8 * 1e4 * 0.01 * np.array(clipped)
    assert np.abs(force - exact).max() < 0.03 * np.abs(exact).max()
    cycle = slice(400, None)
    work = np.sum(0.5 * (force[cycle][1:] + force[cycle][:-1]) * np.diff(drift[cycle]))
    assert work == pytest.approx(4.0 * 0.8 * 1e4 * 0.01 * 0.025, rel=0.03)
    loop = spring_forces(mass_on_spring(20.0), slow_cycles()).sel(spring=0).isel(time=slice(100))
    knee = np.interp(0.01, loop["drift"], loop["z"])  # monotonic: int_0^z dz / (1 - z^n) = 1
    assert sum(knee ** (20 * j + 1) / (20 * j + 1) for j in range(200)) == pytest.approx(1.0, abs=0.01)
    soft = mass_on_spring(2.0)
    loop = spring_forces(soft, slow_cycles())  # negative control: n = 2 is round
    assert np.abs(np.abs(loop["z"].values) - np.abs(clipped)).max() > 0.1


@pytest.mark.parametrize(("sharpness", "beta", "gamma"), [(1.0, 0.7, 0.1), (2.0, 0.5, 0.5), (8.0, 1.0, 0.0)])
def test_springs_dissipate_and_stay_on_their_leash(sharpness, beta, gamma):
    """Work less stored energy never falls, in no spring; |z| <= (beta + gamma)^(-1/n)."""
    chain = bouc_wen(sharpness=sharpness, beta=beta, gamma=gamma)
    loops = spring_forces(chain, noise_record(8, 150), dt=0.001)
    force, drift, z = (loops[name].values for name in ("force", "drift", "z"))
    assert np.abs(drift / 0.008).max() > 2.0
    limit = (beta + gamma) ** (-1.0 / sharpness)
    assert 0.8 * limit < np.abs(z).max() <= limit * (1.0 + 1e-9)
    hysteretic = force - 0.1 * chain.stiffness[:, None] * drift
    np.testing.assert_allclose(hysteretic, 0.9 * chain.stiffness[:, None] * 0.008 * z, atol=1e-12)
    scale = 0.9 * chain.stiffness[:, None] * 0.008**2
    work = 0.5 * (hysteretic[:, 1:] + hysteretic[:, :-1]) * np.diff(drift, axis=1) / scale
    loss = work - 0.5 * np.diff(z**2, axis=1)
    assert loss.min() > -1e-5  # the trapezoidal rule's
    assert (loss.sum(axis=1) > 0.1).all()


@pytest.mark.parametrize("chain", [bouc_wen(), duffing()], ids=str)
def test_output_steps_and_sensors(chain):
    """Every output step gives the same motion at common times."""
    record = noise_record(11, 61)
    base = simulate(chain, record)
    coarse = simulate(chain, record, dt=0.06)
    np.testing.assert_array_equal(coarse.values, base.values[:, ::3])
    np.testing.assert_allclose(coarse["time"], base["time"][::3])
    fine = simulate(chain, record, dt=0.005)
    assert peak_error(fine.values[:, ::4], base.values) < 1e-6
    resampled = Record(np.interp(np.arange(241) / 4, np.arange(61), record.acceleration), 0.005)
    assert peak_error(simulate(chain, resampled).values, fine.values) < 1e-12
    np.testing.assert_array_equal(simulate(chain, record, sensors=[2, 0]).values, base.values[[2, 0]])


def test_spring_forces_are_labelled():
    loops = spring_forces(bouc_wen(2), Record([0.0, 1.0, 0.0], 0.1, name="pulse"), dt=0.05)
    assert dict(loops.sizes) == {"spring": 2, "time": 5}
    assert (loops["force"].attrs["units"], loops["drift"].attrs["units"]) == ("N", "m")
    assert loops.attrs == {"record": "pulse"}
    np.testing.assert_allclose(loops["time"], np.arange(5) * 0.05)
    assert not spring_forces(duffing(2), noise_record())["z"].any()


def test_parameters_may_be_variables():
    dy, n = pt.scalar("dy"), pt.scalar("n")
    symbolic = bouc_wen(2, yield_displacement=[dy, 0.01], sharpness=n)
    assert symbolic.is_symbolic
    table = symbolic.parameters()[-1]
    expected = bouc_wen(2, yield_displacement=[0.02, 0.01], sharpness=3.0).parameters()[-1]
    np.testing.assert_array_equal(table.eval({dy: 0.02, n: 3.0}), expected)
    assert duffing(2, cubic=pt.vector("c", shape=(2,))).is_symbolic


TABLE = {"dy": 0.01, "ratio": 0.1, "n": 2.0, "beta": 0.5, "gamma": 0.5}
INVALID = [
    *({name: np.nan} for name in TABLE),
    {"ratio": -0.1},
    {"gamma": -0.1},
    {"dy": 0.0},
    {"dy": np.inf},
    {"ratio": 1.1},
    {"n": 0.5},
    {"beta": 0.4},
    {"dy": 1e-12},
]


@pytest.mark.parametrize("change", INVALID, ids=str)
def test_invalid_draws_give_nan(change):
    """As a draw would: past the checks of numbers. The last needs absurdly many steps."""

    def run(**values):
        table = np.tile(np.array(list((TABLE | values).values()))[:, None], 2)
        settings = (np.array([0.0, 1.0, 0.5]), 0.02, 1, 1, np.arange(2), 2, 0)
        linear = (np.ones(2), np.full(2, 100.0), np.zeros(2), np.zeros(2))
        return flat_kernels("hysteretic")["response"](*linear, table, *settings)

    assert np.isfinite(run()).all()
    assert np.isnan(run(**change)).all()


def test_any_draw_gives_numbers_or_nan():
    """Never an exception."""
    rng, kernel = np.random.default_rng(0), flat_kernels("hysteretic")["response"]
    for _ in range(200):
        mass, stiffness, dy = 10.0 ** rng.uniform(-6, 6, (3, 2))
        chain = HystereticChain(mass, stiffness, RAYLEIGH, yield_displacement=dy, post_yield_ratio=0.1)
        values = kernel(*chain.parameters(), np.array([0.0, 1.0, -1.0]), 0.02, 1, 1, np.arange(2), 2, 0)
        assert np.isfinite(values).all() or np.isnan(values).all()


@pytest.mark.parametrize("interpolation", ["band-limited", "linear"])
@pytest.mark.parametrize("law", [{}, {"cubic": 0.0}], ids=["hysteretic", "duffing"])
def test_springs_too_stiff_to_step(law, interpolation):
    """Named where they are declared; a thousand times stiffer than others they are like rigid ones."""
    record = Record(smooth_record().acceleration, 0.02, interpolation=interpolation)

    def of(stiffness):
        law_of_springs = law or {"yield_displacement": 10.0, "post_yield_ratio": 0.1}
        kind = DuffingChain if law else HystereticChain
        return kind(np.ones(2), [400.0, stiffness], RayleighDamping(0.2, 0.0), **law_of_springs)

    rigid = simulate(SpringMassChain([2.0], [400.0], RayleighDamping(0.2, 0.0)), record).values
    assert peak_error(simulate(of(4e5), record, sensors=[1]).values, rigid) < 2e-3
    with pytest.raises(ValueError, match=r"Spring 1 \(1e\+20 N/m\) is too stiff for a yielding chain.*Join"):
        simulate(of(1e20), record)
    with pm.Model(), pytest.raises(ValueError, match=r"Spring 1 \(1e\+20 N/m\) is too stiff"):
        response(of(1e20).scale_stiffness(pm.LogNormal("theta", 0.0, 0.1), [0]), record)


REFUSED = {  # what is said: what is given
    "`yield_displacement` must be positive and finite, got 0. .* m": {"yield_displacement": 0.0},
    "one for each of the 3 springs, got 2": {"yield_displacement": [0.1, 0.1]},
    "must lie between 0 and 1, got 1.5. .* `DuffingChain` for": {"post_yield_ratio": 1.5},
    "`sharpness` must be at least 1, got 0.5. Pass 1 to 3 for gradual": {"sharpness": 0.5},
    "`beta` must be positive and finite, got 0": {"beta": 0.0},
    "`cubic` must be finite and not negative, got -1. Pass values in N/m": {"cubic": -1.0},
    "`gamma` must not exceed `beta`, got 0.6 and 0.5. Loops would": {"gamma": [0.5, 0.5, 0.6]},
}


@refusals("changes", REFUSED)
def test_refusals_of_the_chains(changes, match):
    with pytest.raises(ValueError, match=match):
        (duffing if "cubic" in changes else bouc_wen)(**changes)


@pytest.mark.parametrize("chain", [bouc_wen(), duffing()], ids=str)
def test_refusals_of_the_functions(chain):
    record = noise_record()
    with pytest.raises(ValueError, match="`n_modes` must be left out for a nonlinear structure, got 2. ."):
        simulate(chain, record, n_modes=2)
    with pytest.raises(TypeError, match="`record` must be a Record, got list"):
        spring_forces(chain, [1.0])
    for function in (spring_forces, integration_error):
        with pytest.raises(TypeError, match="`record` must be a Record for a .*Chain, got Loading"):
            function(chain, straight.Loading([[0.0, 1.0]], 0.02))
    linear = SpringMassChain(1.0, [1.0], RAYLEIGH)
    for function in (spring_forces, integration_error):
        with pytest.raises(TypeError, match="`structure` must be a nonlinear chain, got SpringMassChain"):
            function(linear, record)
    arguments = (*chain.parameters(), record.acceleration, 0.02, 1, 1, np.arange(3), 2, 0)
    with pytest.raises(ValueError, match="`n_modes` must be all 3 of a nonlinear chain, got 2"):
        flat_kernels(chain.family)["response"](*arguments)
