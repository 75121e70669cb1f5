"""Structures of many storeys in a configuration file: groups, factors, tapers, and their refusals."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
import scipy.linalg

from pymc_features import ExpFeature, ModalDamping, Record, SpringMassChain, response, simulate
from pymc_features.exceptions import ConfigError
from pymc_features.smc import PopulationLogp
from pymc_features.update import read_problem
from pymc_features.update.kinds.model import declare
from support.graphs import LIGHT
from support.structures import noise_record, with_noise

CONFIG = """
[data]
files = "tower.csv"
units = "m/s^2"
base = "base"
sensors = ["low", "high", "roof"]
dofs = [13, 27, 41]

[structure]
type = "SpringMassChain"
n = 42
mass = 4.0e5
stiffness = { base = "k_base", top = "k_top", exponent = "p" }
damping = { type = "ModalDamping", ratios = 0.02 }

[priors]
k_base = { distribution = "LogNormal", mu = 20.7, sigma = 0.2 }
k_top = { distribution = "LogNormal", mu = 19.8, sigma = 0.3 }
p = { distribution = "LogNormal", mu = 0.3, sigma = 0.3 }
sigma = { distribution = "HalfNormal", sigma = 0.5 }

[likelihood]
kinds = ["EXP"]
sigma = "sigma"
"""
TAPER = '{ base = "k_base", top = "k_top", exponent = "p" }'
SENSORS = [13, 27, 41]
DT = 0.05


def stiffnesses(base, top, exponent, n=42):
    """Storey by storey, as the page says."""
    return [base + (top - base) * ((i - 1) / (n - 1)) ** exponent for i in range(1, n + 1)]


@pytest.fixture(scope="module")
def tower(tmp_path_factory):
    """A folder with measurements of 42 storeys."""
    folder = tmp_path_factory.mktemp("tower")
    record = noise_record(400, DT, seed=3)
    chain = SpringMassChain(4.0e5, stiffnesses(1.1e9, 4.5e8, 1.5), ModalDamping(0.02))
    measured = with_noise(simulate(chain, record, sensors=SENSORS), 0.1)
    times = DT * np.arange(400)
    columns = np.column_stack([times, record.acceleration, *measured])
    np.savetxt(folder / "tower.csv", columns, delimiter=",", header="time,base,low,high,roof", comments="")
    return folder


def problem_of(folder, *pairs):
    """The configuration with every old part replaced by a new one, read."""
    text = CONFIG
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "changed.toml"
    path.write_text(text)
    return read_problem(path)


def with_stiffness(value, *names):
    """What to replace for another stiffness, of other priors."""
    start, end = CONFIG.index("k_base = {"), CONFIG.index("sigma = {")
    priors = [f'{name} = {{ distribution = "LogNormal", mu = 20.0, sigma = 0.2 }}\n' for name in names]
    return [(TAPER, value), (CONFIG[start:end], "".join(priors))]


def test_a_tower_from_the_file_is_the_one_written_by_hand(tower):
    """Log-probability, its gradient and natural frequencies with three parameters of a taper."""
    problem = problem_of(tower)
    assert [problem.unit(name) for name in ("k_base", "k_top", "p")] == ["N/m", "N/m", "-"]
    _, base, *sensors = np.loadtxt(tower / "tower.csv", delimiter=",", skiprows=1).T
    with pm.Model() as by_hand:
        k_base = pm.LogNormal("k_base", 20.7, 0.2)
        k_top = pm.LogNormal("k_top", 19.8, 0.3)
        p = pm.LogNormal("p", 0.3, 0.3)
        sigma = pm.HalfNormal("sigma", 0.5)
        x = np.arange(42) / 41.0
        chain = SpringMassChain([4.0e5] * 42, k_base + (k_top - k_base) * x**p, ModalDamping(0.02))
        ExpFeature("y", response(chain, Record(base, DT), sensors=SENSORS), sigma, observed=sensors)
    found = []
    for model in (declare(problem, "EXP"), by_hand):
        compiled = model.compile_fn([model.logp(), model.dlogp()], mode=LIGHT, point_fn=True)
        found.append(compiled({v: x + 0.1 for v, x in by_hand.initial_point().items()}))
    (value, gradient), (expected, expected_gradient) = found
    np.testing.assert_allclose(value, expected, rtol=1e-11)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-7)
    assert (np.abs(gradient) > 1e-3).all()
    drawn = problem.structure(k_base=1.2e9, k_top=4e8, p=1.7)
    k = np.array(stiffnesses(1.2e9, 4e8, 1.7))
    matrix = np.diag(k + [*k[1:], 0.0]) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    omega2 = scipy.linalg.eigh(matrix, 4e5 * np.eye(42), eigvals_only=True)
    np.testing.assert_allclose(drawn.modes().natural_frequencies, np.sqrt(omega2) / (2 * np.pi), rtol=1e-9)


SHORT = {  # a stiffness in short, with its priors: entry by entry, for a = 2e8 and b = 1e8
    '"a"': lambda a, b: [a] * 42,
    "5e8": lambda a, b: [5e8] * 42,
    '{ groups = [["a", 10], [3e8, 20], ["b", 12]] }': lambda a, b: [a] * 10 + [3e8] * 20 + [b] * 12,
    '{ groups = [["a", 40], [{ prior = "b", times = 3 }, 2]], times = 2.0 }': lambda a, b: (
        [2.0 * a] * 40 + [6.0 * b] * 2
    ),
    f'{{ groups = [["a", 20], ["b", 22]], times = {list(range(1, 43))} }}': lambda a, b: (
        [a * i for i in range(1, 21)] + [b * i for i in range(21, 43)]
    ),
    f'{{ prior = "b", times = {list(range(1, 43))} }}': lambda a, b: [b * i for i in range(1, 43)],
    '{ base = "a", top = { prior = "b", times = 0.5 } }': lambda a, b: stiffnesses(a, 0.5 * b, 1.0),
    '{ base = "a", top = 1e8, exponent = 2, times = 3 }': lambda a, b: [
        3.0 * k for k in stiffnesses(a, 1e8, 2.0)
    ],
    f'{{ base = 1.0, top = "b", times = {list(range(1, 43))} }}': lambda a, b: [
        i * k for i, k in enumerate(stiffnesses(1.0, b, 1.0), 1)
    ],
}


@pytest.mark.parametrize("text", SHORT)
def test_values_in_short_are_those_written_out(tower, text):
    """As numbers of a draw, and as variables of a model."""
    names = [name for name in "ab" if f'"{name}"' in text]
    pairs = with_stiffness(text, *names)
    if not names:
        pairs = [*with_stiffness(text, "a"), ("mass = 4.0e5", 'mass = "a"')]
    structure = problem_of(tower, *pairs).structure
    values = {"a": 2e8, "b": 1e8}
    drawn = structure(**{name: values[name] for name in structure.names})
    assert drawn.n_dof == 42
    np.testing.assert_allclose(drawn.stiffness, SHORT[text](**values), rtol=1e-13)
    variables = {name: pt.dscalar(name) for name in structure.names}
    k = structure(**variables).linear_parameters()[1]
    if names:
        k = k.eval({variables[name]: values[name] for name in names}, mode=LIGHT)
    np.testing.assert_allclose(k, SHORT[text](**values), rtol=1e-13)


def test_groups_of_masses_and_of_modes_without_n(tower):
    """The lists say how many; the mass may be random, and dampings have groups of modes."""
    mass, damping = "mass = 4.0e5", "ratios = 0.02"
    problem = problem_of(
        tower,
        ("n = 42\n", ""),
        (mass, "mass = { groups = [[5.0e5, 2], [4.0e5, 40]] }"),
        (damping, 'ratios = { groups = [["zeta", 3], [0.05, 39]] }'),
        ("[priors]", '[priors]\nzeta = { distribution = "LogNormal", mu = -4.0, sigma = 0.3 }'),
    )
    chain = problem.structure(k_base=1e9, k_top=4e8, p=2.0, zeta=0.01)
    assert chain.mass.tolist() == [5e5] * 2 + [4e5] * 40
    np.testing.assert_allclose(chain.stiffness, stiffnesses(1e9, 4e8, 2.0), rtol=1e-14)
    np.testing.assert_allclose(chain.damping.ratios, [0.01] * 3 + [0.05] * 39)
    assert problem.config.uses()["zeta"] == [("structure.damping.ratios", "-")]


def test_springs_that_yield_take_them_too(tower):
    kind = '"SpringMassChain"', '"HystereticChain"'
    more = "n = 42", 'n = 42\nyield_displacement = { base = 0.03, top = "d" }\npost_yield_ratio = 0.1'
    prior = "[priors]", '[priors]\nd = { distribution = "LogNormal", mu = -4.0, sigma = 0.3 }'
    chain = problem_of(tower, kind, more, prior).structure(k_base=1e9, k_top=4e8, p=1.0, d=0.01)
    np.testing.assert_allclose(chain.yield_displacement, stiffnesses(0.03, 0.01, 1.0), rtol=1e-13)
    assert chain.post_yield_ratio.tolist() == [0.1] * 42
    assert chain.sharpness.tolist() == [2.0] * 42


@pytest.mark.parametrize("value", [TAPER, '{ groups = [["a", 10], ["b", 32]] }'])
def test_particles_of_a_tower_are_taken_together(tower, value):
    pairs = [] if value == TAPER else with_stiffness(value, "a", "b")
    model = declare(problem_of(tower, *pairs), "EXP")
    evaluate = PopulationLogp(model, model.initial_point(), {})
    assert evaluate.batched
    particles = evaluate.start + 0.1 * np.random.default_rng(0).normal(size=(4, evaluate.start.shape[1]))
    prior, likelihood, *_ = evaluate(particles)
    one = model.compile_fn(
        [model.varlogp, model.datalogp], inputs=model.value_vars, point_fn=False, mode=LIGHT
    )
    expected = np.transpose([one(*row) for row in particles])
    np.testing.assert_allclose([prior, likelihood], expected, rtol=1e-10)


REFUSED = {  # what is said: what is changed, into what
    "`structure.n` must be the number of storeys, positive, got -42.": ("n = 42", "n = -42"),
    "`structure.n` must be the number of storeys, positive, got 42.0.": ("n = 42", "n = 42.0"),
    "`structure.mass` must have one value or one for each of the n = 42 storeys, got 2. Groups add up": (
        "mass = 4.0e5",
        "mass = [4.0e5, 4.0e5]",
    ),
    "`structure.mass` must have one value or one for each of the n = 42 storeys, got 41. Groups add up": (
        "mass = 4.0e5",
        "mass = { groups = [[4.0e5, 40], [1e5, 1]] }",
    ),
    "`structure.stiffness` must have a number of storeys to taper over, got neither `n` nor a list": (
        "n = 42",
        "",
    ),
    "`structure.stiffness` must taper over two storeys or more, with one value of `times` for each or "
    "for all, got 1 storey.": ("n = 42", "n = 1"),
    "`structure.stiffness` must have one value or one for each of the n = 42 storeys, got 2. Groups add": (
        'exponent = "p"',
        'exponent = "p", times = [1, 2]',
    ),
    "`structure.stiffness` must have `base` and `top` as a taper, got no `top`.": ('top = "k_top", ', ""),
    "`structure.stiffness` must have a `exponent` that is positive, got 0.": ('"p" }', "0 }"),
    "`structure.stiffness` must have a `top` that is positive or zero, got -1.": ('"k_top", ', "-1, "),
    "`structure.stiffness` must have the keys base, top, exponent, times and no others, got 'power'.": (
        "exponent",
        "power",
    ),
    "`structure.stiffness` must have positive numbers as `times`, one or one for each, got -2.": (
        '"p" }',
        '"p", times = -2 }',
    ),
    "`structure.stiffness` must have positive numbers as `times`, one or one for each, got []": (
        TAPER,
        '{ prior = "p", times = [] }',
    ),
    "`structure.stiffness` must be a number, the name of a prior, or {prior = NAME, times = NUMBER}, got": (
        TAPER,
        '{ bottom = "k_base" }',
    ),
    "`structure.stiffness` must have positive whole numbers as counts in `groups`, got -10 in ['p', -10].": (
        TAPER,
        '{ groups = [["p", -10]] }',
    ),
    "`structure.stiffness` must have positive whole numbers as counts in `groups`, got True in ['p'": (
        TAPER,
        '{ groups = [["p", true]] }',
    ),
    "`structure.stiffness` must have pairs [VALUE, COUNT] in `groups`, got 'p'.": (
        TAPER,
        '{ groups = ["p"] }',
    ),
    "`structure.stiffness` must have pairs [VALUE, COUNT] in `groups`, got [].": (TAPER, "{ groups = [] }"),
    "`structure.stiffness` must have one value of `times` for each of the 4 of the groups, got 1.": (
        TAPER,
        '{ groups = [["p", 4]], times = [1] }',
    ),
    "`structure.stiffness` must have the keys groups, times and no others, got 'exponent'.": (
        TAPER,
        '{ groups = [["p", 4]], exponent = 1.0 }',
    ),
    "`structure.stiffness` must name priors of the file, got 'k_roof'. Add it to [priors]": (
        '"k_top", ',
        '"k_roof", ',
    ),
    "`structure.damping.ratios` must be a number, the name of a prior": (
        "ratios = 0.02",
        "ratios = { base = 0.01, top = 0.02 }",
    ),
    "`ratios` must have one value or one for each of the 42 modes, got 41.": (
        "ratios = 0.02",
        "ratios = { groups = [[0.01, 41]] }",
    ),
    "`data.dofs` must be different numbers from 0 to 39": ("n = 42", "n = 40"),
}


@pytest.mark.parametrize("message", REFUSED)
def test_wrong_storeys_name_the_key(tower, message):
    with pytest.raises(ConfigError) as caught:
        problem_of(tower, REFUSED[message])
    assert message in str(caught.value)


def test_a_taper_without_n_takes_the_number_of_its_factors(tower):
    without = ("n = 42\n", ""), ("4.0e5", "[4.0e5, 4.0e5]"), ('"p" }', '"p", times = [1, 2, 3] }')
    with pytest.raises(ConfigError, match="must taper over two .* got 3 values of `times` for 2 storeys"):
        problem_of(tower, *without)
