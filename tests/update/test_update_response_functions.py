"""[frequency_response] of update.toml: what is read, checked, sampled, predicted and reported."""

import numpy as np
import pytest

import pymc_features as pmf
from modal.test_response_functions import MASS, POINTS, RATIO, SENSORS, SPRINGS, F, exact
from pymc_features.exceptions import ConfigError
from pymc_features.update import read_problem, run_update, write_outputs

TEXT = """
[frequency_response]
files = "functions.csv"
units = "(m/s^2)/N"
{places}
band = [1.0, 9.4]
sigma_f = "error_f"
sigma_zeta = 0.1
sigma_phi = 0.05
[structure]
type = "SpringMassChain"
mass = {mass}
stiffness = ["k1", "k2", 700.0]
damping = {{ type = "ModalDamping", ratios = "zeta" }}
[priors]
k1 = {{ distribution = "LogNormal", mu = {mu}, sigma = 0.2 }}
k2 = {{ distribution = "LogNormal", mu = 6.7, sigma = 0.2 }}
zeta = {{ distribution = "LogNormal", mu = -4.6, sigma = 0.4 }}
error_f = {{ distribution = "HalfNormal", sigma = 0.02 }}
[sampler]
draws = 200
chains = 2
"""
PLACES = 'responses = { "1:+x" = 1, "2:+x" = 2 }\nreferences = { "0:+x" = 0, "2:+x" = 2 }'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Functions of the chain with errors of 0.5 %, as a table with pairs of columns."""
    folder = tmp_path_factory.mktemp("functions")
    h, rng = exact(), np.random.default_rng(1)
    h = (
        h
        + 0.005
        * np.sqrt(0.5 * np.mean(np.abs(h) ** 2))
        * (rng.standard_normal((2, *h.shape)).T @ [1.0, 1.0j]).T
    )
    columns, names = [F], ["frequency [Hz]"]
    for i, a in enumerate(SENSORS):
        for j, r in enumerate(POINTS):
            columns += [h[i, j].real, h[i, j].imag]
            names += [f"{a}:+x / {r}:+x {part}" for part in ("real", "imaginary")]
    np.savetxt(
        folder / "functions.csv", np.column_stack(columns), delimiter=",", header=",".join(names), comments=""
    )
    return folder


def problem_of(folder, places=PLACES, mu=6.8):
    """The problem of the file."""
    path = folder / "update.toml"
    path.write_text(TEXT.format(places=places, mass=MASS.tolist(), mu=mu))
    return read_problem(path)


@pytest.mark.slow
def test_a_posterior_and_its_report(folder):
    """The truth is in the posterior, the modes are in the tables, and the functions are drawn."""
    problem = problem_of(folder)
    result = run_update(problem, cores=1, progressbar=False)
    for name, value in (("k1", SPRINGS[0]), ("k2", SPRINGS[1]), ("zeta", RATIO)):
        draws = result[f"FRF/posterior/{name}"].values
        assert abs(np.log(draws / value).mean()) < 4.0 * np.log(draws).std()
    verdict = problem.verdict(result, "FRF")
    assert verdict.explains and "The model has the 3 modes" in verdict.sentences[0]
    functions = result["FRF/functions"].to_dataset()
    off = np.abs(np.log(functions["size"].sel(quantile=0.5) / functions["measured"]))
    assert off.median() < 0.1 and off.quantile(0.99) < 0.5  # noise shows between the peaks
    write_outputs(problem, result, folder / "report")
    page = (folder / "report" / "report.html").read_text()
    assert (
        "Modes of response functions" in page
        and (folder / "report" / "figures" / "FRF_response_functions.png").is_file()
    )


def test_what_is_checked(folder, capsys):
    """What was read, and a prior that is far away in the first sentences."""
    problem = problem_of(folder)
    assert problem.data[0].used == "3 modes in 4 frequency response functions"
    with pytest.warns(pmf.exceptions.PriorWarning, match="The priors expect"):
        problem_of(folder, mu=9.5)


@pytest.mark.parametrize(
    "places, words",
    [
        ("", "`responses` must be given for a structure"),
        (
            'responses = { "1:+x" = 1 }',
            "`frequency_response.responses` must have every label, got none of 2:",
        ),
        (
            PLACES.replace("= 1", "= 7"),
            "`frequency_response.responses` must be degrees of freedom from 0 to 2",
        ),
    ],
)
def test_places_that_are_missing(folder, places, words):
    """Each label needs one."""
    with pytest.raises(ConfigError, match=words):
        problem_of(folder, places)
