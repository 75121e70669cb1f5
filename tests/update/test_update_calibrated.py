"""CAL and GAMMA in an update: what is sampled for them, kept and reported."""

import json
import shutil
import warnings

import numpy as np
import pytest
import xarray as xr

from pymc_features import cli
from pymc_features.calibration.sandwich import sentence
from pymc_features.exceptions import CalibrationWarning, ConfigError
from pymc_features.update import read_problem, sampling, write_example
from pymc_features.update.kinds.model import declare
from pymc_features.update.report.document import rows_of_result
from pymc_features.update.sampling import Running
from support.update_files import replaced, variant
from update.test_update import table_of

pytestmark = pytest.mark.slow

SMALL = [
    ('kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]', 'kinds = ["GAMMA", "CAL"]'),
    ("# m = 10.0 ", "m = [2.0, 3.0, 4.5] #"),
    ("draws = 1000", "draws = 400"),
    ("chains = 2", "chains = 1"),
    ("# trim = [0.0, 10.0]", "trim = [0.0, 6.0]"),
    (', "base_shear"', ""),
]
DOUBT = "the errors of y persist for 3 s of a record of 6 s"


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    path = tmp_path_factory.mktemp("calibrated") / "frame.toml"
    write_example(path, synthetic=True)
    path.write_text(replaced(path.read_text(), SMALL))
    return path


@pytest.fixture(scope="module")
def finished(example, blank_module):
    """A run that is stopped before CAL and continued; its errors are said to persist."""
    out, calibrate = example.with_name("out"), sampling.calibrate

    def stopped(*_, **__):
        raise KeyboardInterrupt

    def doubtful(*arguments, **settings):
        warnings.warn(DOUBT, CalibrationWarning, stacklevel=2)
        return calibrate(*arguments, **settings)

    with pytest.MonkeyPatch.context() as patch:
        command = ["update", str(example), "--out", str(out), "--cores", "1"]
        patch.setattr(sampling, "calibrate", stopped)
        assert cli.main(command) == 130
        assert sorted(path.name for path in (out / "parts").glob("*.nc")) == ["GAMMA.nc", "NORM.nc"]
        patch.setattr(sampling, "calibrate", doubtful)
        patch.setattr(sampling, "sample", None)  # nothing is sampled again
        assert cli.main(command) == 0
    return out


@pytest.fixture(scope="module")
def result(finished):
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        return tree.load()


def test_report_leads_with_it_and_says_why(finished, result):
    html = (finished / "report.html").read_text()
    n_eff = result["CAL/calibration"].attrs["n_eff"]
    assert 100 < n_eff < 1803
    sentence = (
        f"The residuals support {n_eff:,.0f} independent observations; NORM claims 1,803, GAMMA 10. CAL comes"
    )
    assert html.count(sentence) == 1
    assert html.index(sentence) < html.index("<h2>Warnings</h2>")
    assert "under CAL, GAMMA. Accelerations" in html
    _, body = table_of(html, "Posterior")
    assert list(dict.fromkeys(row[0] for row in body)) == ["CAL", "GAMMA"]
    assert "NORM was sampled" not in html
    assert "Its likelihood is that of NORM to the power " in html
    told = html[html.index("CAL was sampled") : html.index("GAMMA was sampled")]
    assert "log evidence" not in told  # that of a stretched likelihood must not be compared


def test_its_warnings_are_in_the_report(finished):
    said = f"{DOUBT[:1].upper()}{DOUBT[1:]}"
    assert f"<li>CAL: {said}</li>" in (finished / "report.html").read_text()


def test_everything_of_the_others_is_there(finished, result):
    assert set(result.children) == {"CAL", "GAMMA", "data", "geometry"}
    assert set(result["GAMMA"].children) <= set(result["CAL"].children)
    figures = {path.stem for path in (finished / "figures").iterdir()}
    for name in ("prior_posterior", "response", "response_zoom"):
        assert {f"CAL_{name}", f"GAMMA_{name}"} <= figures
    assert result["CAL"].attrs["method"] == "calibrate"
    assert result["CAL/calibration"]["sensor"].values.tolist() == ["floor1", "floor2", "floor3"]


def test_draws_are_as_wide_as_the_residuals_support(finished, result):
    """On the scale of the logarithms, which is sampled; NORM claims less, GAMMA knows of ten observations.

    400 draws: the standard error of a standard deviation is 4 %.
    """
    found = result["CAL/calibration"].to_dataset()
    with xr.open_datatree(finished / "parts" / "NORM.nc", engine="h5netcdf") as norm:
        claimed = np.log(norm["posterior"]["k1"].values).std()
    calibrated, wide = (np.log(result[f"{kind}/posterior"]["k1"].values).std() for kind in ("CAL", "GAMMA"))
    assert (found["time_constant"] < 0.2).all()  # s, of noise that is white before it is filtered
    expected = found["standard_deviation"].sel(parameter="k1")
    assert calibrated == pytest.approx(float(expected), rel=0.16)
    assert claimed < calibrated < 0.2 * wide


def told(problem, result, explains=True):
    """What is said of the width."""
    return " ".join(text for text, _ in problem.first.sentences(problem, result, explains))


def test_no_sentence_without_it(example, result):
    assert told(read_problem(example), result.drop_nodes("CAL")) == ""


def test_it_needs_a_scale(example, tmp_path):
    path = variant(example, tmp_path, ('"GAMMA", "CAL"', '"CAL"'), ('sigma = "sigma" ', "#"))
    with pytest.raises(ConfigError, match="`likelihood` must have the key `sigma` for CAL, got none."):
        read_problem(path)


def test_data_that_tell_no_width_are_refused_by_the_key(example, monkeypatch):
    def refused(*_, **__):
        raise ValueError("the residuals of y must not vanish, got none at sensor 1.")

    monkeypatch.setattr(sampling, "calibrate", refused)
    wanted = "`likelihood.kinds` must have CAL only where residuals can tell a width: the residuals of y must"
    with pytest.raises(ConfigError, match=wanted):
        sampling.calibrated(read_problem(example), "CAL", None, None, Running(1))


def test_gamma_takes_its_observations_as_they_are_given(example, tmp_path):
    problem = read_problem(example)
    model = declare(problem, "GAMMA")
    *_, m = model["y"].owner.inputs
    assert model["y"].owner.op.name == "GammaFeature"
    assert m.eval().tolist() == [2.0, 3.0, 4.5]
    assert {rv.name for rv in model.free_RVs} == {"k1", "k2", "k3", "zeta", "sigma"}
    one = read_problem(variant(example, tmp_path, ("[2.0, 3.0, 4.5]", "7.5"), ('"GAMMA", "CAL"', '"GAMMA"')))
    *_, m = declare(one, "GAMMA")["y"].owner.inputs
    assert m.eval() == 7.5
    assert one.kinds == ["GAMMA"]


def test_order_of_sampling_and_of_the_report(example, tmp_path):
    assert read_problem(example).kinds == ["GAMMA", "NORM", "CAL"]
    kinds = '["GAMMA", "ABC", "CAL", "EXP", "NORM"]'
    problem = read_problem(variant(example, tmp_path, ('["GAMMA", "CAL"]', kinds)))
    assert problem.kinds == ["GAMMA", "EXP", "NORM", "ABC", "CAL"]
    assert problem.reported == ["CAL", "GAMMA", "ABC", "EXP", "NORM"]


def test_what_is_finished_is_reported_where_it_cannot_be_had(example, finished, tmp_path, monkeypatch):
    """The others are shown with the reason; if it was the only one asked for, what it is made from."""

    def refused(*_, **__):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(sampling, "calibrate", refused)
    monkeypatch.setattr(sampling, "sample", None)  # what is finished is not sampled again
    alone = [('"GAMMA", "CAL"', '"CAL"'), ("m = [2.0, 3.0, 4.5]", "#")]
    for changes, shown in (([], "GAMMA"), (alone, "NORM")):
        path = example.with_name("changed.toml")
        path.write_text(replaced(example.read_text(), changes))
        out = tmp_path / f"out-{shown}"
        shutil.copytree(finished, out)
        (out / "parts" / "CAL.nc").unlink()
        assert cli.main(["update", str(path), "--out", str(out), "--cores", "1"]) == 0
        html = (out / "report.html").read_text()
        assert "CAL only where residuals can tell a width: Eigenvalues did not converge" in html
        assert list(dict.fromkeys(row[0] for row in table_of(html, "Posterior")[1])) == [shown]


def test_no_interval_comes_first_of_a_model_that_does_not_explain(example, result):
    problem = read_problem(example)
    assert "CAL comes first, for its intervals" in told(problem, result)
    said = told(problem, result, explains=False)
    assert "comes first" not in said
    assert "No interval can be relied on where the model does not explain the measurements." in said


def test_intervals_at_a_bound_are_the_shortest_and_said_to_be(example, result):
    """k1 of a run, as if its prior ended at its median; its growth, as if bands disagreed."""
    changed, k1 = result.copy(), result["CAL/posterior"]["k1"]
    bound = float(k1.quantile(0.999))
    known = json.loads(result["CAL"].attrs["calibration"])
    assert set(known["parameters"]) == {"k1", "k2", "k3", "zeta", "sigma"}
    known["parameters"]["k1"] |= {"near_bound": True, "bound": bound, "room": 0.5}
    known["sentence"] = sentence(2.4)
    changed["CAL"].attrs["calibration"] = json.dumps(known)
    problem = read_problem(example)
    said = told(problem, changed)
    assert f"Next to a bound of its prior the 90 % interval is the shortest one: k1 ({bound:.4g})." in said
    assert "disagree about the parameters by a factor of 2.4" in said
    [row] = [r for r in rows_of_result(problem, changed) if (r.kind, r.name) == ("CAL", "k1")]
    [before] = [r for r in rows_of_result(problem, result) if (r.kind, r.name) == ("CAL", "k1")]
    assert row.q95 - row.q05 <= before.q95 - before.q05
    assert row.q50 == before.q50
