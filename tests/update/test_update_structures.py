"""Structures in a configuration file: by name, of many storeys, by matrices, and those of docs/update.md."""

import inspect
import tomllib

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
import scipy.linalg

from pymc_features import ExpFeature, ModalDamping, Record, SpringMassChain, response, simulate, structures
from pymc_features.exceptions import ConfigError
from pymc_features.smc import PopulationLogp
from pymc_features.update import read_problem
from pymc_features.update.config import structures as structure_sections
from pymc_features.update.config.structures import StructureOf
from pymc_features.update.kinds.base import declare
from support.graphs import LIGHT
from support.pages import PAGES, blocks
from support.structures import noise_record, with_noise
from support.update_files import replaced, variant

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
    path = folder / "changed.toml"
    path.write_text(replaced(CONFIG, pairs))
    return read_problem(path)


def with_stiffness(value, *names):
    """What to replace for another stiffness, of other priors."""
    start, end = CONFIG.index("k_base = {"), CONFIG.index("sigma = {")
    priors = [f'{name} = {{ distribution = "LogNormal", mu = 20.0, sigma = 0.2 }}\n' for name in names]
    return [(TAPER, value), (CONFIG[start:end], "".join(priors))]


def test_a_tower_from_the_file_is_the_one_written_by_hand(tower):
    """Log-probability, its gradient and natural frequencies with three parameters of a taper."""
    problem = problem_of(tower)
    assert [problem.units[name] for name in ("k_base", "k_top", "p")] == ["N/m", "N/m", "-"]
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


FACTORS = list(range(1, 43))
SHORT = {  # a stiffness in short, with its priors: entry by entry, for a = 2e8 and b = 1e8
    "5e8": lambda a, b: [5e8] * 42,
    '{ groups = [["a", 40], [{ prior = "b", times = 3 }, 2]], times = 2.0 }': lambda a, b: (
        [2.0 * a] * 40 + [6.0 * b] * 2
    ),
    f'{{ groups = [["a", 42]], times = {FACTORS} }}': lambda a, b: [a * i for i in FACTORS],
    f'{{ prior = "b", times = {FACTORS} }}': lambda a, b: [b * i for i in FACTORS],
    '{ base = "a", top = { prior = "b", times = 0.5 } }': lambda a, b: stiffnesses(a, 0.5 * b, 1.0),
    f'{{ base = 1.0, top = "b", exponent = 2, times = {FACTORS} }}': lambda a, b: (
        np.array(FACTORS) * stiffnesses(1.0, b, 2.0)
    ),
}


@pytest.mark.parametrize("text", SHORT)
def test_values_in_short_are_those_written_out(tower, text):
    """As numbers of a draw, and as variables of a model; the mass may be one."""
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


def test_particles_of_a_tower_are_taken_together(tower):
    model = declare(problem_of(tower), "EXP")
    evaluate = PopulationLogp(model, model.initial_point(), {})
    assert evaluate.batched
    particles = evaluate.start + 0.1 * np.random.default_rng(0).normal(size=(4, evaluate.start.shape[1]))
    prior, likelihood, *_ = evaluate(particles)
    one = model.compile_fn(
        [model.varlogp, model.datalogp], inputs=model.value_vars, point_fn=False, mode=LIGHT
    )
    expected = np.transpose([one(*row) for row in particles])
    np.testing.assert_allclose([prior, likelihood], expected, rtol=1e-10)


MATRICES = """
type = "AffineStructure"
mass = { file = "frame.npz", name = "M" }
stiffness = { file = "frame.npz", name = "K0" }
stiffness_terms = [{ file = "frame.npz", name = "K1" }, { file = "frame.npz", name = "K2" }]
theta = ["k1", { prior = "k2", times = 2.0 }]
damping = { type = "RayleighDamping", alpha = 0.1, beta = "zeta" }
"""


def test_matrices_come_from_files(example, tmp_path):
    lower, upper = np.diag([1.0, 0.0, 0.0]), np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
    top = 600.0 * np.array([[0.0, 0, 0], [0, 1, -1], [0, -1, 1]])
    masses = np.diag([0.1601, 0.1601, 0.1421])
    np.savez(tmp_path / "frame.npz", M=masses, K0=top, K1=lower, K2=upper)
    text = example.read_text()
    section = text[text.index("[structure]") + len("[structure]") : text.index("[priors]")]
    k3 = next(line for line in text.splitlines() if line.startswith("k3 ="))
    drift = '"inter_storey_drift", '
    path = variant(example, tmp_path, (section, MATRICES), (k3, ""), (drift, ""))
    mass, damping, stiffness = read_problem(path).structure(k1=385.0, k2=210.0, zeta=1e-3).matrices()
    expected = top + 385.0 * lower + 420.0 * upper
    np.testing.assert_allclose(stiffness, expected)
    np.testing.assert_allclose(damping, 0.1 * masses + 1e-3 * expected)
    wrong = variant(example, tmp_path, (section, MATRICES.replace('"K1"', '"K9"')), (k3, ""), (drift, ""))
    with pytest.raises(ConfigError, match=r"`structure.stiffness_terms\[0\].name` must be one of the"):
        read_problem(wrong)
    with pytest.raises(ConfigError, match="must not have inter_storey_drift for a structure without"):
        read_problem(variant(example, tmp_path, (section, MATRICES), (k3, "")))


CHAIN = """
type = "{}"
mass = 0.15
stiffness = ["k1", "k2", "k3"]
damping = {{ type = "ModalDamping", ratios = ["zeta", 0.02, 0.01] }}
"""
FRAME = """
type = "LinearStructure"
mass = [0.1, 0.1, 0.1]
stiffness = [[800.0, -400.0, 0.0], [-400.0, 800.0, -400.0], [0.0, -400.0, 400.0]]
damping = { type = "RayleighDamping", alpha = "zeta", beta = 1e-4 }
"""
YIELDS = "yield_displacement = {{ base = 0.03, top = 0.01 }}\n"
SECTIONS = {
    "SpringMassChain": CHAIN,
    "HystereticChain": f"{CHAIN}{YIELDS}post_yield_ratio = 0.1\n",
    "DuffingChain": f'{CHAIN}cubic = {{{{ prior = "k1", times = 100.0 }}}}\n',
    "LinearStructure": FRAME.replace("{", "{{").replace("}", "}}"),
}
VALUES = {"k1": 385.0, "k2": 420.0, "k3": 600.0, "zeta": 0.3}


def test_every_structure_is_known_and_states_all_its_arguments():
    assert {*SECTIONS, "AffineStructure"} == set(structure_sections.STRUCTURES)
    for cls in (*structures.STRUCTURES, *structures.DAMPINGS):
        assert set(cls.inputs) == set(inspect.signature(cls).parameters)


@pytest.mark.parametrize("name", SECTIONS)
def test_structures_by_name(name):
    raw = tomllib.loads(SECTIONS[name].format(name))
    built = StructureOf(structure_sections.STRUCTURES[name].model_validate(raw), ".")
    structure = built(**{n: v for n, v in VALUES.items() if n in built.names})
    assert type(structure) is getattr(structures, name)
    if name == "LinearStructure":
        mass, damping, stiffness = structure.matrices()
        np.testing.assert_allclose(damping, 0.3 * mass + 1e-4 * stiffness)
        return
    assert structure.mass.tolist() == 0.15
    assert structure.stiffness.tolist() == [385.0, 420.0, 600.0]
    assert structure.damping.ratios.tolist() == [0.3, 0.02, 0.01]
    if name == "DuffingChain":
        assert structure.cubic == 38500.0
    if name == "HystereticChain":
        np.testing.assert_allclose(structure.yield_displacement, [0.03, 0.02, 0.01], rtol=1e-13)


REFUSED = {  # what is said: what is changed, into what
    "`structure.n` must be the number of storeys, positive, got -42.": ("n = 42", "n = -42"),
    "`structure.mass` must have one value or one for each of the": ("mass = 4.0e5", "mass = [4.0e5, 4.0e5]"),
    "`structure.stiffness` must have a number of storeys to taper over, got neither `n` nor": ("n = 42", ""),
    "`structure.stiffness` must taper over two storeys or more, with one value of": ("n = 42", "n = 1"),
    "`structure.stiffness` must have one value or one for each of the n = 42 storeys, got 2. Groups add": (
        'exponent = "p"',
        'exponent = "p", times = [1, 2]',
    ),
    "`structure.stiffness.top` must be given: a number, the name of a prior, or": ('top = "k_top", ', ""),
    "`structure.stiffness` must have a `exponent` that is positive, got 0.": ('"p" }', "0 }"),
    "`structure.stiffness` must have a `top` that is positive or zero, got -1.": ('"k_top", ', "-1, "),
    "`structure.stiffness.power` must be left out, it is no key. Known here:": ("exponent", "power"),
    "`structure.stiffness.times` must be a positive number, got -2.": ('"p" }', '"p", times = -2 }'),
    "`structure.stiffness.bottom` must be left out, it is no key. Known": (TAPER, '{ bottom = "k_base" }'),
    "COUNT a positive whole number, got -10.": (TAPER, '{ groups = [["p", -10]] }'),
    "`structure.stiffness.groups` must be a list of pairs [VALUE, COUNT],": (TAPER, '{ groups = ["p"] }'),
    "COUNT a positive whole number, got [].": (TAPER, "{ groups = [] }"),
    "`structure.stiffness` must have one value of `times`": (TAPER, '{ groups = [["p", 4]], times = [1] }'),
    "`structure.stiffness.exponent` must be left out here, got 1.0.": (
        TAPER,
        '{ groups = [["p", 4]], exponent = 1.0 }',
    ),
    "`structure.damping.ratios.base` must be left out,": (
        "ratios = 0.02",
        "ratios = { base = 0.01, top = 0.02 }",
    ),
    "`ratios` must have one value or one for each": ("ratios = 0.02", "ratios = { groups = [[0.01, 41]] }"),
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


# --------------------------------------------------------------------------- the page


[PAGE] = [path for path in PAGES if path.name == "update.md"]
EXAMPLES = [text for text in blocks(PAGE, "toml") if text.startswith("[structure]")]
REST = """
sigma = {{ distribution = "HalfNormal", sigma = 0.5 }}

[data]
files = "roof.csv"
units = "m/s^2"
base = "base"
sensors = ["roof"]
dofs = [{dof}]

[likelihood]
kinds = ["EXP"]
sigma = "sigma"
"""


def of_page(text, folder, dof):
    """The problem of a structure and its priors, with a sensor on one degree of freedom."""
    times = 0.02 * np.arange(100)
    table = np.column_stack([times, np.sin(20.0 * times), np.cos(20.0 * times)])
    np.savetxt(folder / "roof.csv", table, delimiter=",", header="time,base,roof", comments="")
    for code in blocks(PAGE, "python use"):
        exec(compile(code, str(PAGE), "exec"), {})
    path = folder / "page.toml"
    path.write_text(text + REST.format(dof=dof))
    return read_problem(path)


@pytest.mark.filterwarnings("ignore:1 sensor with one sigma")
@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_structures_of_the_page_can_be_updated(tmp_path, monkeypatch, number):
    monkeypatch.chdir(tmp_path)
    problem = of_page(EXAMPLES[number], tmp_path, dof=0)
    model = declare(problem, "EXP")
    assert {rv.name for rv in model.free_RVs} == set(problem.priors)


def test_modes_of_the_page_can_be_updated(tmp_path):
    [text] = [text for text in blocks(PAGE, "toml") if text.startswith("[modal]")]
    (tmp_path / "modes.csv").write_text("frequency,roof,floor 1,floor 2\n2.6,1,0.3,0.6\n7.1,-0.7,0.7,0.9\n")
    path = tmp_path / "page.toml"
    path.write_text(text)
    problem = read_problem(path)
    model = declare(problem, "MODAL")
    assert {rv.name for rv in model.free_RVs} == set(problem.priors) == {"lower", "upper", "sigma_phi"}
    assert [rv.name for rv in model.observed_RVs] == ["modal"]
    assert problem.modal.data.channels == ("floor 2", "roof")
    assert (problem.modal.dofs, problem.modal.n_modes) == ([1, 3], 4)


def example(word):
    """The one with a word in it."""
    [found] = [text for text in EXAMPLES if word in text]
    return found


def test_groups_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tower = of_page(example("k_mid"), tmp_path, dof=41).structure(k_low=9e8, k_mid=7e8, zeta=0.02)
    assert tower.stiffness.tolist() == [9e8] * 10 + [7e8] * 20 + [3e8] * 12
    assert tower.mass.tolist() == [5.2e5] * 2 + [4e5] * 40
    assert tower.damping.ratios.tolist() == [0.02] * 3 + [0.05] * 39


@pytest.mark.parametrize("line", [0, 1, 2])
def test_factors_of_the_page(tmp_path, monkeypatch, line):
    """The line that is given, and those that are comments."""
    monkeypatch.chdir(tmp_path)
    lines = example("drawings").splitlines()
    shown = [text.removeprefix("# ") for text in lines if text.removeprefix("# ").startswith("stiffness")]
    first = lines.index(shown[0])
    text = "\n".join([*lines[:first], shown[line], *lines[first + 3 :]])
    if '"upper"' not in shown[line]:
        text = "\n".join(row for row in text.splitlines() if not row.startswith("upper"))
    structure = of_page(text, tmp_path, dof=4).structure
    chain = structure(**{name: {"lower": 0.8, "upper": 1.2}[name] for name in structure.names})
    factors = [[0.8, 0.8, 1.2, 1.2, 1.2], [0.8] * 5, [0.8, 0.9, 1.0, 1.1, 1.2]][line]
    np.testing.assert_allclose(chain.stiffness, np.array([9e8, 8e8, 8e8, 6e8, 5e8]) * factors)


def test_matrices_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problem = of_page(example("AffineStructure"), tmp_path, dof=2)
    mass, damping, stiffness = problem.structure(lower=0.9, upper=1.1, tank=0.5, beta=1e-3).matrices()
    np.testing.assert_allclose(mass, np.diag([4.5e5, 4e5, 4e5]))
    expected = [[0.9 * 4 + 1.1 * 3 + 0.5, -1.1 * 3 - 0.5, 0], [-3.8, 1.1 * 5 + 0.5, -2.2], [0, -2.2, 2.2]]
    np.testing.assert_allclose(stiffness, 1e8 * np.array(expected))
    np.testing.assert_allclose(damping, 0.1 * mass + 1e-3 * stiffness)
    assert problem.structure.n_modes == 2
    assert problem.units["beta"] == "s"
    assert "frame.npz_sha256" in problem.settings()
