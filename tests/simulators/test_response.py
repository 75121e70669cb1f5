"""The response against matrix exponentials, closed forms, published peaks, OpenSees and Newmark."""

import json

import numpy as np
import pytensor.tensor as pt
import pytest
import xarray as xr

from pymc_features import ModalDamping, RayleighDamping, SpringMassChain, paper, simulate
from pymc_features.simulators import QUANTITIES, UNITS
from support.kernels import chain_discrepancy, chain_response
from support.newmark import newmark
from support.reference import first_order_hold, interpolated
from support.straight import Record
from support.structures import DAMPINGS, noise_record, random_chain


def full_response(structure, record, *, substeps=1, stride=1):
    """All quantities without modes: first-order hold of M u" + C u' + K u = -M a_g."""
    matrix_m, matrix_c, matrix_k = structure.matrices()
    n = len(matrix_m)
    damping, stiffness = np.linalg.solve(matrix_m, matrix_c), np.linalg.solve(matrix_m, matrix_k)
    ground = interpolated(record.acceleration[None], substeps)
    u, v, relative = first_order_hold(
        damping, stiffness, -np.ones((n, 1)), ground, record.dt / substeps, stride
    )
    [ground] = ground[:, ::stride]
    return dict(zip(QUANTITIES, (relative + ground, relative, v, u), strict=True), ground=ground)


def oscillator(omega, zeta):
    """One mass of 1 kg."""
    return SpringMassChain([1.0], omega**2, ModalDamping(zeta))


def displacement(structure, record, **kwargs):
    return simulate(structure, record, quantity="relative_displacement", **kwargs).values


def assert_close_to_peak(actual, expected, tolerance):
    """Largest difference over the largest value."""
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=tolerance * np.abs(expected).max())


@pytest.fixture(scope="module")
def ten_storeys():
    """The chain of the reference files."""
    return SpringMassChain(np.ones(10), 1800.0, RayleighDamping(0.2265, 6.7515e-4))


@pytest.mark.parametrize(
    ("file", "rms", "peak"),
    [
        ("exact_10dof_elcentro_absacc.csv", 1e-7, 1e-6),
        ("opensees_10dof_elcentro_absacc_h0p0002.csv", 1e-3, 1e-2),
    ],
)
def test_reference_files(reference_dir, ten_storeys, file, rms, peak):
    table = np.loadtxt(reference_dir / file, delimiter=",", skiprows=1)
    record = Record(table[:, 1], dt=0.02)
    ours = simulate(ten_storeys, record).values
    theirs = table[:, 2:].T
    assert ours.shape == theirs.shape == (10, 1559)
    assert_close_to_peak(ours, theirs, peak)
    error = np.sqrt(np.mean((ours - theirs) ** 2, axis=1) / np.mean(theirs**2, axis=1))
    assert error.max() < rms
    # negative control: the printed 1000 N/m is another structure
    soft = SpringMassChain(np.ones(10), 1000.0, RayleighDamping(0.2265, 6.7515e-4))
    assert np.abs(simulate(soft, record).values - theirs).max() > 0.5 * np.abs(theirs).max()


@pytest.fixture(scope="module")
def chopra(reference_dir):
    return json.loads((reference_dir / "chopra_reference.json").read_text())


@pytest.fixture(scope="module")
def el_centro_g(data_dir):
    """El Centro in units of g, so that each book's g can be used."""
    if not (data_dir / "elcentro.dat").exists():
        pytest.skip("no elcentro.dat")
    return np.loadtxt(data_dir / "elcentro.dat")[:, 1]


@pytest.mark.parametrize("case", range(5))
def test_published_peaks_of_oscillators(chopra, el_centro_g, case):
    """Chopra, sec. 6.4, to 0.3 %, at the record's samples; g = 386.4 in/s^2."""
    published = chopra["sdof_peak_displacement_in"]
    expected = published["cases"][case]
    record = Record(el_centro_g * published["g_in_per_s2"], dt=0.02)
    structure = oscillator(2 * np.pi / expected["T"], expected["zeta"])
    peak = np.abs(displacement(structure, record)).max()
    assert peak == pytest.approx(expected["published"], rel=3e-3)
    assert peak == pytest.approx(expected["exact_scout"], rel=2e-4)


@pytest.fixture(scope="module")
def five_storeys(chopra, el_centro_g):
    """Chopra's shear frame (sec. 13.2.6): published numbers, chain, record."""
    book = chopra["five_storey_shear_frame"]
    chain = SpringMassChain(
        np.full(5, float(book["m_kg"])), book["k_N_per_m"], ModalDamping(book["zeta_all_modes"])
    )
    return book, chain, Record(el_centro_g * book["g_mps2"], dt=0.02)


def frame_forces(u, stiffness, height):
    """Top displacement [cm], top and base shear [kN], base moment [kN m] from displacements (5, t)."""
    shear = stiffness * np.diff(u, axis=0, prepend=0.0)  # below each floor
    moment = height * shear.sum(axis=0)
    return {"u5_cm": 100 * u[-1], "V5_kN": shear[-1] / 1e3, "Vb_kN": shear[0] / 1e3, "Mb_kNm": moment / 1e3}


def test_published_peaks_of_a_frame(five_storeys):
    """Chopra, sec. 13.2.6: periods to the printed digits, totals to 0.3 %, modes to 0.5 % and rounding.

    The part of each mode is the difference of truncated responses.
    """
    book, chain, record = five_storeys
    np.testing.assert_allclose(1 / chain.modes().natural_frequencies, book["periods_s"], atol=6e-5)
    geometry, before = (book["k_N_per_m"], book["storey_height_m"]), 0.0
    for r in range(5):
        upto = displacement(chain, record, dt=0.004, n_modes=r + 1)
        for name, history in frame_forces(upto - before, *geometry).items():
            expected = book["published_peaks"][name]["modes"][r]
            rounding = 0.06 if name == "Mb_kNm" else 6e-4
            assert np.abs(history).max() == pytest.approx(expected, rel=5e-3, abs=rounding), (r, name)
        before = upto
    for name, history in frame_forces(before, *geometry).items():
        assert np.abs(history).max() == pytest.approx(book["published_peaks"][name]["total"], rel=3e-3)


@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("seed", [0, 3, 6, 7])
def test_against_full_matrix_exponential(seed, damping):
    """One to eight masses, records around blocks, 1e-10 of the peak; no modes in the other route."""
    n_times = {0: 2, 3: 129, 6: 150, 7: 257}[seed]
    chain, record = random_chain(seed, damping), noise_record(n_times, seed=seed)
    exact = full_response(chain, record)
    for quantity in QUANTITIES:
        assert_close_to_peak(simulate(chain, record, quantity=quantity).values, exact[quantity], 1e-10)


@pytest.mark.parametrize(("substeps", "stride"), [(1, 2), (1, 7), (10, 1)])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_output_steps(substeps, stride, quantity):
    """Multiples and divisors of the record's step, with the rounding of a division; the last whole step."""
    record = noise_record(301, seed=3)
    for seed in (0, 4):
        chain = random_chain(seed)
        dt = record.dt * stride / substeps * (1.0 + 1e-12)
        ours = simulate(chain, record, dt=dt, quantity=quantity)
        exact = full_response(chain, record, substeps=substeps, stride=stride)[quantity]
        assert_close_to_peak(ours.values, exact, 1e-10)
        np.testing.assert_allclose(ours["time"], np.arange(exact.shape[1]) * dt, rtol=1e-11)


@pytest.mark.parametrize("sensors", [[3, 0], (1, 1, 2), np.array([2])])
def test_sensor_subsets(sensors):
    chain, record = random_chain(3), noise_record(150, seed=1)
    for kwargs in ({}, {"n_modes": 2}):
        everything = simulate(chain, record, **kwargs)
        some = simulate(chain, record, sensors=sensors, **kwargs)
        assert some["sensor"].values.tolist() == list(sensors)
        assert_close_to_peak(some.values, everything.values[list(sensors)], 1e-13)


@pytest.mark.parametrize("zeta", [0.0, 0.05, 1.0, 3.0])
def test_step_response_of_an_oscillator(zeta):
    omega, level = 7.0, 2.5
    record = Record(np.full(200, level), 0.02)
    t = record.time
    root = omega * np.sqrt(complex(zeta**2 - 1.0))
    if zeta == 1.0:
        decay = np.exp(-omega * t) * (1.0 + omega * t)
    else:
        hyperbolic = np.cosh(root * t) + zeta * omega / root * np.sinh(root * t)
        decay = (np.exp(-zeta * omega * t) * hyperbolic).real
    exact = -level / omega**2 * (1.0 - decay)
    assert_close_to_peak(displacement(oscillator(omega, zeta), record)[0], exact, 1e-12)


def harmonic_error(dt, omega=8.0, zeta=0.05, drive=5.0):
    """RMS error against the closed form for a_g = sin(drive t), zero initial conditions."""
    record = Record(np.sin(drive * np.arange(round(6.0 / dt) + 1) * dt), dt)
    t = record.time
    dynamic = -1.0 / (omega**2 - drive**2 + 2j * zeta * omega * drive)
    damped = omega * np.sqrt(1 - zeta**2)
    forced = (dynamic * np.exp(1j * drive * t)).imag
    start, slope = dynamic.imag, (1j * drive * dynamic).imag
    free = start * np.cos(damped * t) + (slope + zeta * omega * start) / damped * np.sin(damped * t)
    exact = forced - np.exp(-zeta * omega * t) * free
    error = displacement(oscillator(omega, zeta), record)[0] - exact
    return np.sqrt(np.mean(error**2) / np.mean(exact**2))


def test_harmonic_response_of_an_oscillator():
    """The only error is the record's interpolation: (drive dt)^2 / 12, so a quarter at half the step."""
    errors = np.array([harmonic_error(dt) for dt in (0.04, 0.02, 0.01, 0.005)])
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.02)
    assert errors[1] == pytest.approx((5.0 * 0.02) ** 2 / 12, rel=0.1)


def test_at_rest_at_the_first_sample():
    """The ground may start with a jump; displacement and velocity do not."""
    chain, record = random_chain(3), Record([2.0, 1.0, 0.0], 0.02)
    histories = {q: simulate(chain, record, quantity=q).values for q in QUANTITIES}
    for quantity in ("relative_displacement", "relative_velocity", "absolute_acceleration"):
        assert abs(histories[quantity][:, 0]).max() < 1e-14 * abs(histories[quantity]).max()
    np.testing.assert_allclose(histories["relative_acceleration"][:, 0], -2.0, rtol=1e-14)


@pytest.mark.parametrize("n_modes", [1, 4, 5])
def test_truncation_and_feed_through(n_modes):
    """Kept modes one by one as oscillators, and J_c a_g = (1 - sum phi Gamma) a_g, Eq. (24)."""
    chain = random_chain(4, "mixed")
    record = noise_record(150, seed=6)
    modes = chain.modes()
    expected = dict.fromkeys(QUANTITIES, 0.0)
    carried = np.zeros((chain.n_dof, 1))
    for r in range(n_modes):
        shape = (modes.mode_shapes[:, r] * modes.participation_factors[r])[:, None]
        carried += shape
        single = full_response(
            oscillator(modes.angular_frequencies[r], modes.damping_ratios[r]), record, substeps=2
        )
        for quantity in QUANTITIES:
            expected[quantity] = expected[quantity] + shape * single[quantity]
        ground = single["ground"]
    expected["absolute_acceleration"] = expected["absolute_acceleration"] + (1 - carried) * ground
    for quantity in QUANTITIES:
        ours = simulate(chain, record, n_modes=n_modes, quantity=quantity, dt=record.dt / 2).values
        assert_close_to_peak(ours, expected[quantity], 1e-10)
    absolute = simulate(chain, record, n_modes=n_modes).values
    relative = simulate(chain, record, n_modes=n_modes, quantity="relative_acceleration").values
    assert_close_to_peak(absolute - relative, np.tile(record.acceleration, (chain.n_dof, 1)), 1e-12)
    feed = np.abs(1 - carried).max()
    assert feed < 1e-12 if n_modes == chain.n_dof else feed > 1e-3


def newmark_error(chain, record, divisor, beta=0.25):
    """RMS error of each floor's absolute acceleration over its RMS."""
    fine = np.arange((record.n_times - 1) * divisor + 1) * (record.dt / divisor)
    ground = np.interp(fine, record.time, record.acceleration)
    matrices = chain.matrices()
    force = -np.outer(np.diag(matrices[0]), ground)
    approximate = (newmark(*matrices, force, record.dt / divisor, beta=beta)[2] + ground)[:, ::divisor]
    exact = simulate(chain, record).values
    return np.sqrt(np.mean((approximate - exact) ** 2, axis=1) / np.mean(exact**2, axis=1))


@pytest.mark.parametrize("beta", [0.25, 1 / 6])
def test_newmark_converges_to_the_response_with_order_two(beta):
    chain = SpringMassChain(np.ones(3), [400.0, 300.0, 200.0], RayleighDamping(0.2, 1e-3))
    record = noise_record(60, seed=9)
    errors = np.array([newmark_error(chain, record, d, beta).max() for d in (4, 8, 16, 32)])
    orders = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.05)
    assert errors[-1] < 1e-3


def test_newmark_at_the_step_of_the_record_is_far_off(record, ten_storeys):
    """At 0.02 s average acceleration is 31 to 86 % wrong in the floor accelerations of El Centro."""
    errors = newmark_error(ten_storeys, record, 1)
    if record.pga == pytest.approx(0.31882 * 9.81):  # El Centro, not its synthetic stand-in
        assert (round(errors.min(), 2), round(errors.max(), 2)) == (0.31, 0.86)
    assert errors.min() > 0.1


def kernel_arguments(**changes):
    """Arguments of `chain_response` for two masses."""
    arguments = {
        "mass": np.array([1.0, 2.0]),
        "stiffness": np.array([100.0, 50.0]),
        "rayleigh": np.array([0.1, 1e-3]),
        "ratios": np.zeros(2),
        "acceleration": np.array([0.0, 1.0, -1.0]),
        "dt": 0.02,
        "substeps": 1,
        "stride": 1,
        "sensors": np.arange(2),
        "n_modes": 2,
    }
    return [*(arguments | changes).values(), 0]


INVALID = [
    {"mass": np.array([1.0, -2.0])},
    {"mass": np.array([np.inf, 2.0])},
    {"stiffness": np.array([100.0, 0.0])},
    {"stiffness": np.array([np.nan, np.nan])},
    {"rayleigh": np.array([0.0, np.inf])},
    {"rayleigh": np.array([-1.0, 0.0])},
    {"ratios": np.array([0.0, np.nan])},
    {"ratios": np.array([-0.1, 0.0])},
]


def named(case):
    return "-".join(f"{name}={value.tolist()}" for name, value in case.items())


@pytest.mark.parametrize("case", INVALID, ids=named)
def test_invalid_parameters_give_nan(case):
    assert np.isfinite(chain_response(*kernel_arguments())).all()
    assert np.isnan(chain_response(*kernel_arguments(**case))).all()
    errors = chain_discrepancy(*kernel_arguments(**case), np.zeros((2, 3)))
    assert errors.shape == (2,)
    assert np.isnan(errors).all()


def test_any_positive_parameters_give_numbers_or_nan():
    """Heavy-tailed priors draw absurd values: never an exception, never a hang."""
    rng = np.random.default_rng(0)
    for _ in range(500):
        mass, stiffness, ratios = 10.0 ** rng.uniform(-100, 100, (3, 2))
        rayleigh = 10.0 ** rng.uniform(-100, 100, 2)
        case = {"mass": mass, "stiffness": stiffness, "rayleigh": rayleigh, "ratios": ratios}
        history = chain_response(*kernel_arguments(**case))
        assert np.isfinite(history).all() or np.isnan(history).all()


def test_result_is_labelled():
    chain = random_chain(2)
    record = Record([0.0, 1.0, 0.0, 2.0], 0.1, name="pulse")
    for quantity in QUANTITIES:
        history = simulate(chain, record, sensors=[2, 0], dt=0.05, quantity=quantity)
        assert isinstance(history, xr.DataArray)
        assert history.dims == ("sensor", "time")
        assert history.name == quantity
        assert history.attrs == {"units": UNITS[quantity], "record": "pulse"}
        assert history["sensor"].values.tolist() == [2, 0]
        assert history["time"].attrs["units"] == "s"
        np.testing.assert_allclose(history["time"], [0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3], rtol=1e-14)
    assert [UNITS[q] for q in QUANTITIES] == ["m/s^2", "m/s^2", "m/s", "m"]


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"dt": -0.02}, "`dt` must be positive, got -0.02. Pass the output step in seconds"),
        (
            {"dt": 0.03},
            "`dt` must be an integer multiple or divisor of the record's step 0.02 s, got 0.03 s. Resample",
        ),
        ({"quantity": "drift"}, "`quantity` must be one of absolute_acceleration, .* got 'drift'"),
        ({"n_modes": 4}, "`n_modes` must be an integer from 1 to 3, got 4. Leave it out for all modes"),
        ({"n_modes": True}, "`n_modes` must be an integer from 1 to 3, got True"),
        ({"sensors": [3]}, r"`sensors` must lie between 0 and 2, got \[3\]. Degree of freedom 0 is next"),
        ({"sensors": []}, r"`sensors` must be a list of degrees of freedom \(integers\), got \[\]"),
        ({"sensors": [True, False, True]}, "`sensors` must be a list of degrees of freedom"),
        ({"sensors": [[0, 1]]}, "`sensors` must be a list of degrees of freedom"),
    ],
)
def test_refusals(kwargs, match):
    with pytest.raises(ValueError, match=match):
        simulate(random_chain(2), noise_record(150, seed=0), **kwargs)


@pytest.mark.parametrize(
    ("structure", "record", "match"),
    [
        ("chain", Record([0.0, 1.0], 0.1), "`structure` must be a structure, got str"),
        (random_chain(1), [1.0, 2.0], "`record` must be a Record, got list"),
        (
            paper.chain(pt.scalar("theta")),
            Record([0.0, 1.0], 0.1),
            "must have numbers as parameters, got PyTensor variables. Use `response",
        ),
    ],
)
def test_refused_types(structure, record, match):
    with pytest.raises(TypeError, match=match):
        simulate(structure, record)
