"""A part of a record is compared with the response from the start; a window that begins in motion is told."""

import warnings

import numpy as np
import pymc as pm
import pytest

from pymc_features import CorrelatedNormal, ModalDamping, SpringMassChain, response
from pymc_features.exceptions import ChannelWarning, ConfigError
from pymc_features.update import read_problem, run_update, write_example
from pymc_features.update.kinds.base import declare
from support.update_files import replaced

KINDS = 'kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]'
TAU = 'tau = { distribution = "HalfNormal", sigma = 0.1 }\n'
TRIM = "# trim = [0.0, 10.0]"


def written(folder, *pairs):
    path = folder / "part.toml"
    path.unlink(missing_ok=True)
    (folder / "part-measured.csv").unlink(missing_ok=True)
    write_example(path, synthetic=True)
    path.write_text(replaced(path.read_text(), list(pairs)))
    return path


@pytest.mark.slow
def test_log_density_is_that_of_a_sliced_response(tmp_path):
    pairs = (TRIM, "compare = [4.0, 9.0]"), ("zeta = {", f"{TAU}zeta = {{")
    kind = KINDS, 'kinds = ["CN-TAU"]\ncorrelation_time = "tau"'
    problem = read_problem(written(tmp_path, kind, *pairs))
    measured = problem.measured
    assert measured.channels.sizes["time"] == 501 == measured.motion.size
    assert measured.channels["time"].values[[0, -1]] == pytest.approx([4.0, 9.0])
    with pm.Model() as own:
        k = [pm.LogNormal(f"k{i}", mu, 0.2) for i, mu in ((1, 6.0), (2, 6.2), (3, 6.3))]
        zeta, sigma = pm.LogNormal("zeta", -4.6, 0.4), pm.HalfNormal("sigma", 0.5)
        chain = SpringMassChain([0.1601, 0.1601, 0.1421], pm.math.stack(k), ModalDamping(zeta))
        mu, tau = response(chain, measured.record)[:, 400:901], pm.HalfNormal("tau", 0.1)
        CorrelatedNormal("y", mu, sigma, tau, 0.01, observed=measured.channels.values)
    compiled = [m.compile_logp(mode="FAST_COMPILE") for m in (declare(problem, "CN-TAU"), own)]
    point = own.initial_point()
    assert compiled[0](point) == pytest.approx(compiled[1](point), rel=1e-10)


def told(path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        problem = read_problem(path)
    return problem, [str(w.message) for w in caught if issubclass(w.category, ChannelWarning)]


@pytest.mark.slow
def test_a_trim_into_motion_moves_frequencies_and_a_compared_window_does_not(tmp_path):
    """Laplace's approximation of NORM, with noise of 5 %: the truth is within four standard deviations.

    Control: after a trim to the same window it is not, and a warning says so.
    """
    common = [(KINDS, 'kinds = ["NORM"]'), ('method = "auto"', 'method = "laplace"')]
    common += [("draws = 1000", "draws = 300"), ('["inter_storey_drift", "base_shear"]', "[]")]
    truth = 3.699
    off = {}
    for name, line in (("compare", "compare = [4.0, 9.0]"), ("trim", "trim = [4.0, 9.0]")):
        problem, messages = told(written(tmp_path, *common, (TRIM, line)))
        assert len(messages) == (name == "trim")
        assert all("cuts into the motion of floor1, floor2, floor3 at 4 s" in m for m in messages)
        found = run_update(problem, progressbar=False)["NORM/modal"]["natural_frequency"].sel(mode=1)
        off[name] = abs(float(found.mean()) - truth) / float(found.std())
    assert off["compare"] < 4.0
    assert off["trim"] > 6.0


def test_a_trim_that_begins_at_rest_is_not_told(tmp_path):
    path = written(tmp_path)
    table = np.genfromtxt(path.with_name("part-measured.csv"), delimiter=",", names=None, skip_header=1)
    rng = np.random.default_rng(0)
    still = 0.05 * rng.standard_normal((400, 5))
    rows = np.vstack([still, table])
    rows[:, 0] = 0.01 * np.arange(len(rows))
    file = path.with_name("part-measured.csv")
    header = file.read_text().splitlines()[0]
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.6f")
    path.write_text(replaced(path.read_text(), [(TRIM, "trim = [3.5, 14.0]")]))
    assert told(path)[1] == []


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("compare = [4.0, 9.0]", "`likelihood.kinds` must not have ABC with `processing.compare`"),
        ("compare = [9.0, 4.0]", r"`processing.compare` must be two rising times"),
        ("compare = [4.0, 40.0]", r"`compare` must lie within the record, 0 s to 12 s"),
    ],
)
def test_windows_that_are_none(tmp_path, line, match):
    with pytest.raises(ConfigError, match=match):
        read_problem(written(tmp_path, (TRIM, line)))
