"""Updating a specimen with a cyclic test: what is found, the report, and what is refused."""

import numpy as np
import pytest

import pymc_features as pmf
from pymc_features import cli
from pymc_features.exceptions import ConfigError
from pymc_features.update import read_problem, run_update
from pymc_features.update.report.outputs import write_outputs
from support.browser import check_page, needs_browser
from support.refusals import refusals
from support.report_pages import words

TRUE = {"k": 2e7, "d_y": 0.008, "slip": 0.7}
TEXT = """
[cyclic]
files = "wall.csv"
units = ["mm", "kN"]

[structure]
type = "HystereticSpecimen"
stiffness = "k"
yield_displacement = "d_y"
post_yield_ratio = 0.05
degradation = { stiffness = 0.03 }
pinching = { slip = "slip", spread = 0.3 }

[priors]
k = { distribution = "LogNormal", mu = 16.6, sigma = 0.4 }
d_y = { distribution = "LogNormal", mu = -4.8, sigma = 0.4 }
slip = { distribution = "Uniform", lower = 0.0, upper = 0.95 }
sigma = { distribution = "HalfNormal", sigma = 3e4 }

[likelihood]
kinds = ["NORM"]
sigma = "sigma"

[sampler]
method = "laplace"
draws = 300
"""


def write(folder, text=TEXT):
    """A table of a specimen with the values `TRUE`, errors of 4 kN, and the configuration."""
    specimen = pmf.structures.HystereticSpecimen(
        TRUE["k"],
        yield_displacement=TRUE["d_y"],
        post_yield_ratio=0.05,
        degradation=pmf.structures.Degradation(stiffness=0.03),
        pinching=pmf.structures.Pinching(TRUE["slip"], spread=0.3),
    )
    ways = np.arange(121) / 12
    displacement = 0.008 * np.interp(ways, range(11), [0, 1, -1, 2, -2, 3, -3, 4, -4, 4, -4])
    force = pmf.simulate(specimen, pmf.structures.CyclicTest(displacement)).values[0]
    force += 4e3 * np.random.default_rng(1).standard_normal(force.size)
    np.savetxt(folder / "wall.csv", np.column_stack([1e3 * displacement, 1e-3 * force]), delimiter=",")
    (folder / "update.toml").write_text(text)
    return folder / "update.toml"


@pytest.fixture(scope="module")
def updated(tmp_path_factory, blank_module):
    """Problem, result and what is written."""
    problem = read_problem(write(folder := tmp_path_factory.mktemp("cyclic")))
    result = run_update(problem, progressbar=False)
    return problem, result, write_outputs(problem, result, folder / "out")


@pytest.mark.slow
def test_the_truth_is_found_and_reported(updated):
    problem, result, paths = updated
    posterior = result["NORM/posterior"].to_dataset()
    for name, value in TRUE.items():  # outside of 4 standard deviations in one of 15,000 data sets
        mean, sd = float(posterior[name].mean()), float(posterior[name].std())
        assert abs(mean - value) < 4.0 * sd < 0.2 * value
    found = problem.verdict(result, "NORM")
    assert found.explains
    assert found.sentences == [
        "The specimen explains the loops: it accounts for 100 % of the force (share of the mean square)."
    ]
    assert problem.units["sigma"] == "N" and problem.units["slip"] == "-"
    assert "NORM_loops.png" in {path.name for path in paths}
    page = words(paths[-1].read_text())
    assert "121 measured forces of a cyclic test" in page and "displacement [m]" in page
    assert "natural frequencies" not in page and "m/s²" not in page


@needs_browser
def test_nothing_of_the_page_is_cut_off(updated, browser):
    check_page(browser, updated[2][-1])


@pytest.mark.slow
def test_a_specimen_that_cannot_do_it_is_told(tmp_path):
    text = TEXT.replace('pinching = { slip = "slip", spread = 0.3 }', "").replace("stiffness = 0.03", "")
    lines = [line for line in text.split("\n") if not line.startswith("slip")]
    problem = read_problem(write(tmp_path, "\n".join(lines)))
    found = problem.verdict(run_update(problem, progressbar=False), "NORM")
    assert "an error of the model, largest at a displacement of" in found.sentences[-1]


def test_check_draws_what_the_priors_expect(tmp_path, capsys):
    assert cli.main(["check", str(write(tmp_path))]) == 0
    assert "of the measured forces lie within what the priors expect" in capsys.readouterr().err
    assert (tmp_path / "update-check.png").is_file()


CHAIN = 'type = "SpringMassChain"\nmass = 1.0\nn = 1\nstiffness = "k"\n'
CHAIN += 'damping = { type = "ModalDamping", ratios = "slip" }\n\n'
REFUSALS = {
    "`structure.type` must be HystereticSpecimen with .cyclic.": (
        TEXT[TEXT.index("type =") : TEXT.index("[priors]")],
        CHAIN,
    ),
    "`cyclic` must be given for a HystereticSpecimen": (TEXT[: TEXT.index("[structure]")], ""),
    "`data` must be left out with .cyclic., got it": ("[priors]", '[data]\nsensors = ["a"]\n[priors]'),
    "`report.quantities` must be left out with": (
        "[priors]",
        '[report]\nquantities = ["base_shear"]\n[priors]',
    ),
    "`likelihood` must be given with .cyclic.": (TEXT[TEXT.index("sigma = {") : TEXT.index("[sampler]")], ""),
    "`cyclic.units` must be two units": ('["mm", "kN"]', '["mm"]'),
    r"`units` must be one of .* got .g.": ('["mm", "kN"]', '["mm", "g"]'),
    "`structure.pinching.slip` must be a number": ('slip = "slip"', "slip = true"),
}


@refusals("change", REFUSALS)
def test_refusals(tmp_path, change, match):
    with pytest.raises(ConfigError, match=match):
        read_problem(write(tmp_path, TEXT.replace(*change)))
