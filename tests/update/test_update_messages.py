"""What is said of configurations that are wrong, and what keys and priors may be."""

import pytest
import scipy.stats
from pydantic import ValidationError

from pymc_features import cli
from pymc_features.exceptions import ConfigError
from pymc_features.update.config import priors
from pymc_features.update.config import structures as structure_sections
from pymc_features.update.problem import read_config
from support.update_files import SIGMA, variant

KINDS, HALF = 'kinds = ["EXP", "ABC"]', '"HalfNormal"'
DOFS = "# dofs = [0, 1, 2]"
OF_TIME = "\ncorrelation_time = 0.05 #"
BROKEN = {  # what is said: what is changed, into what
    "`sampler.drwas` must be left out, it is no key. Did you": ("draws = 100", "drwas = 100"),
    "`sampling` must be left out, it is no key. Did you mean": ("[sampler]", "[sampling]"),
    "`structure.damping.ratio` must be left out, it is no key. Did": ('ratios = "zeta"', 'ratio = "zeta"'),
    "`sampler.draws` must be a whole number from 50 to 10000000, draws of": ("draws = 100", 'draws = "many"'),
    '`sampler.method` must be "auto", "smc", "nuts" or "laplace", got \'gibbs\'.': ('"auto"', '"gibbs"'),
    "`sampler` must have `kernel` only with `method` smc,": ("draws = 100", 'kernel = "TMCMC"\ndraws = 100'),
    "`likelihood.kinds` must be a list of NORM, TN, EXP, ABC, CN, CN-SIGMA,": ('["EXP", "ABC"]', '["MAX"]'),
    "`likelihood` must have `epsilon` for ABC, or EXP among": ('["EXP", "ABC"]', '["ABC"]'),
    "[data]: `files` must be an existing file, got": ("frame-measured.csv", "nothing.csv"),
    "[data]: `units` must be one of": ('# units = "m/s^2" ', 'units = "furlong" #'),
    "`data.sensors` must be among the sensors base, floor1": ('"floor3"]', '"roof"]'),
    "`data.base` must be among the sensors base": ('base = "base" ', 'base = "ground"'),
    "`data.sensors` must be one for each of the 3 degrees of freedom of the structure,": (', "floor3"]', "]"),
    "`data.dofs` must have one value for each of": (DOFS, "dofs = [0, 1]"),
    "`data.dofs` must be different degrees of freedom from 0 to 2": (DOFS, "dofs = [0, 1, 3]"),
    "`data.rows` must be two rows or more from 0 on, [first, the one": (DOFS, "rows = [10, 10]"),
    "`data.rows` must lie within the": (DOFS, "rows = [0, 900000]"),
    "`data.scale` must be a factor for all sensors, or a table": (DOFS, 'scale = "g"'),
    "`scale` must name sensors among base, floor1, floor2, floor3": (DOFS, "scale = { attic = -1.0 }"),
    "`delay` must be at most a quarter of the record": (DOFS, "delay = { floor1 = 100.0 }"),
    "`structure.type` must be one of SpringMassChain, LinearStructure,": ('"SpringMassChain"', '"Steel"'),
    "[structure]: `mass` must be positive and finite, got": ("mass = [0.1601, ", "mass = [-0.1601, "),
    "[structure]: `mass` and `stiffness` must have the": ('["k1", "k2", "k3"]', '["k1", "k2", "k3", 600.0]'),
    "`structure.stiffness` must be a number, the name of a prior": ('["k1", "k2", "k3"]', "[true]"),
    "`structure.stiffness` must name priors of the file, got": ('["k1", "k2", "k3"]', '["k1", "k2", "k4"]'),
    "`priors.k3` must be used by the structure": ('["k1", "k2", "k3"]', '["k1", "k2", 600]'),
    "`priors.draw` must have a name of letters, digits and underscores that is not": ("k3 = {", "draw = {"),
    "`priors.sigma.distribution` must be a continuous distribution of": (HALF, '"HalfNormol"'),
    "`priors.sigma.distribution` must be a continuous distribution of PyMC, got": (HALF, '"__import__"'),
    "`priors.sigma` must be a `distribution` that can": ('"HalfNormal", sigma = 0.5', '"HalfFlat"'),
    "`priors.sigma` must have arguments of HalfNormal (sigma, tau) alone, got": (
        '"HalfNormal", sigma',
        '"HalfNormal", scale',
    ),
    "`priors.sigma` must have admissible arguments of HalfNormal, got": ("sigma = 0.5", "sigma = -0.5"),
    "`priors.sigma` must have finite numbers, got sigma = 'half'.": ("sigma = 0.5", 'sigma = "half"'),
    "`priors.sigma` must be used by the structure or a likelihood": (SIGMA, "sigma = 0.3 "),
    "`likelihood` must have the key `correlation_time` for CN-TAU,": ('["EXP", "ABC"]', '["EXP", "CN-TAU"]'),
    "`likelihood` must have `correlation_time` only with CN,": (SIGMA, f"{SIGMA}\ncorrelation_time = 0.05 #"),
    "the name of a prior as `correlation_time` for CN-TAU, which": (KINDS, f'kinds = ["CN-TAU"]{OF_TIME}'),
    "must have numbers as `sigma` for CN, which takes it for known, got": (KINDS, f'kinds = ["CN"]{OF_TIME}'),
    "`likelihood` must have the key `m` for GAMMA, got none.": ('["EXP", "ABC"]', '["EXP", "GAMMA"]'),
    "`likelihood` must have `m` only with GAMMA, got kinds ['EXP', 'ABC'].": (SIGMA, f"{SIGMA}\nm = 3 #"),
    "must have numbers as `m` for GAMMA, which takes it for": (KINDS, 'kinds = ["GAMMA"]\nm = "zeta" #'),
    "`likelihood.m` must be positive, got -3. 1": (KINDS, 'kinds = ["GAMMA"]\nm = -3 #'),
    "`likelihood.correlation_time` must be posit": (KINDS, 'kinds = ["CN-SIGMA"]\ncorrelation_time = -1 #'),
    "`likelihood.sigma` must be one value or one for each of the 3": (SIGMA, 'sigma = ["sigma"] '),
    "[processing.trim]: `start, stop` must lie within the record": ("[0.0, 6.0]", "[0.0, 60.0]"),
    "`processing.trim` must be two rising times [from, to]": ("[0.0, 6.0]", "[6.0, 0.0]"),
    "[processing.band_pass]: `high` must lie between 0 and 50 Hz": ("high = 25.0", "high = 80.0"),
    "`report.natural_frequencies` must": ("natural_frequencies = [", "natural_frequencies = [9, "),
    "must be a TOML file": ("[sampler]", "[sampler"),
    "must be a TOML file: Exceeds the limit (4300 digits)": ("draws = 100", f"draws = {'9' * 5000}"),
    "must be a TOML file: lists in it are nested too": ("draws = 100", f"draws = {'[' * 30000}{']' * 30000}"),
    "`sampler.draws` must be a number of at most 64 bits, got one of 100.": ("= 100", f"= {2**99}"),
    "`sampler` must have keys of at most 200 characters, got 201.": ("draws = 100", f"{'d' * 201} = 100"),
    "[processing.band_pass]: `order` must be an integer": ("high = 25.0 }", "high = 25.0, order = 1000000 }"),
    "[data]: `files` must be readable, got '/": ("frame-measured.csv", "x" * 5000),
    "`likelihood.sigma` must be positive, got the prior `priors.sigma` with the median -2": (
        '"HalfNormal", sigma = 0.5',
        '"Uniform", lower = -3.0, upper = -2.0',
    ),
}


@pytest.mark.parametrize("message", BROKEN)
def test_broken_configurations_name_the_key(example, tmp_path, capsys, message):
    assert cli.main(["update", str(variant(example, tmp_path, BROKEN[message]))]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert error.splitlines()[-1].startswith("pymc-features: error: ")
    assert not (tmp_path / "changed-output").exists()


def test_missing_configuration_and_traceback(tmp_path, capsys):
    missing = str(tmp_path / "no.toml")
    assert cli.main(["update", missing]) == 2
    assert "`CONFIG` must be an existing file" in capsys.readouterr().err
    with pytest.raises(FileNotFoundError, match="`pymc-features init` writes an example"):
        cli.main(["update", missing, "--traceback"])


def test_every_key_says_what_it_must_be(example):
    config, _ = read_config(example)
    sections = [config, config.data, config.processing, config.likelihood, config.sampler, config.report]
    classes = [type(s) for s in sections] + list(structure_sections.STRUCTURES.values())
    for cls in classes:
        for name, field in cls.model_fields.items():
            assert field.description or name == "type", f"{cls.__name__}.{name}"


def test_two_errors_are_counted(example, tmp_path):
    path = variant(example, tmp_path, ("draws = 100", "draws = 1"), ("random_seed = 0", "random_seed = -1"))
    with pytest.raises(ConfigError, match=r"`sampler.draws` .* \(1 more after this one.\)"):
        read_config(path)


def prior_of(distribution, arguments):
    """As of the file."""
    return priors.Prior(distribution=distribution, **arguments)


def test_priors_are_the_distributions_of_pymc():
    draws = prior_of("Gamma", {"mu": 3.0, "sigma": 0.5}).draw(4000, 1)
    assert scipy.stats.kstest(draws, scipy.stats.gamma(36.0, scale=1.0 / 12.0).cdf).pvalue > 1e-3
    points = {"x_points": [0, 1, 2], "pdf_points": [0, 1, 0]}
    draws = prior_of("Interpolated", points).draw(4000, 1)
    assert scipy.stats.kstest(draws, scipy.stats.triang(0.5, scale=2.0).cdf).pvalue > 1e-3
    with pytest.raises(ValidationError, match="must be a scalar"):
        prior_of("Normal", {"mu": [0.0, 1.0], "sigma": 1.0})
    with pytest.raises(ValidationError, match="Either use alpha and beta"):
        prior_of("Gamma", {"alpha": 2.0})
    for points in ([1, -1, 2], [0, -1, 0]):
        with pytest.raises(ValidationError, match="must have a positive and finite density"):
            prior_of("Interpolated", {"x_points": [0, 1, 2], "pdf_points": points})
    with pytest.raises(ValidationError, match="must have admissible arguments of PolyaGamma"):
        prior_of("PolyaGamma", {"h": -1.0, "z": 0.0})  # or polyagamma is not installed
    with pytest.raises(ValidationError, match="must spread over finite values"):
        prior_of("Uniform", {"lower": 2.0, "upper": 2.0})
