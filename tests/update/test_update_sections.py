"""Predictions, candidates, what sensors can see, and how a folder of results is kept."""

import contextlib
import io
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from pymc_features import cli
from pymc_features.exceptions import ConfigError, StudyMismatchError
from pymc_features.prediction import posterior_response
from pymc_features.storage import PartStore, held
from pymc_features.update import read_problem, sampling, write_example
from pymc_features.update.config import keys
from pymc_features.update.run import candidates_of
from pymc_features.update.sensitivity import remaining, sensitivity_sentences
from support.update_files import replaced

QUICK = [
    ('kinds = ["CAL", "NORM", "TN", "EXP", "ABC"]', 'kinds = ["EXP"]'),
    ("draws = 1000", "draws = 100"),
    ("chains = 2", "chains = 1"),
    ("# trim = [0.0, 10.0]", "trim = [0.0, 6.0]"),
]
PREDICT = """
[[predict]]
name = "half"
scale = 0.5
quantities = ["inter_storey_drift", "base_shear"]
limits = { inter_storey_drift = [0.005, 1e3] }
"""
COMPARE = """
[compare.one_spring]
structure = { stiffness = "k1" }
weight = 2.0
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The example, with a prediction and candidates."""
    path = tmp_path_factory.mktemp("sections") / "frame.toml"
    write_example(path, synthetic=True)
    path.write_text(replaced(path.read_text(), QUICK) + PREDICT + COMPARE)
    return path


@pytest.fixture(scope="module")
def finished(path, blank_module):
    """Its folder, after an update that prints its findings."""
    said, found = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(found):
        assert cli.main(["update", str(path), "--json", "--fail-on", "verdict", "--cores", "1"]) == 0
    out = path.with_name("frame-output")
    (out / "said.txt").write_text(said.getvalue())
    (out / "found.json").write_text(found.getvalue())
    return out


def loaded(file):
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        return tree.load()


@pytest.mark.slow
def test_predictions_are_those_of_the_posterior(path, finished):
    result, problem = loaded(finished / "update.nc"), read_problem(path)
    found, record = result["predict/half"].to_dataset(), problem.measured.record
    np.testing.assert_allclose(found["ground_acceleration"], 0.5 * record.acceleration)
    names, posterior = ["inter_storey_drift", "base_shear"], result["EXP/posterior"].to_dataset()
    step = float(found["time"][1])
    medians = {name: float(posterior[name].median()) for name in problem.structure.names}
    highest = problem.structure(**medians).modes().natural_frequencies.max()
    assert (
        step * highest <= 1 / 16 < step * 2 * highest
    )  # samples in the shortest period, no more than needed
    expected = posterior_response(posterior, problem.structure, record, names, draws=500, dt=step)
    for name in names:  # of a linear structure
        np.testing.assert_allclose(found[name], 0.5 * expected[name], rtol=1e-6)
    peak = found["inter_storey_drift_peak"].max("storey")
    share = float((peak > 0.005).mean())
    np.testing.assert_allclose(found["inter_storey_drift_probability_any"], [share, 0.0])
    assert "Largest responses to other motions" in (finished / "said.txt").read_text()
    [row, never, shear] = json.loads((finished / "found.json").read_text())["predicted"]
    assert (row["limit"], row["probability"], never["probability"]) == (0.005, pytest.approx(share), 0.0)
    np.testing.assert_allclose(row["quantiles"], np.quantile(peak, [0.05, 0.5, 0.95]))
    assert shear["quantity"] == "base shear" and shear["limit"] is None


@pytest.mark.slow
def test_candidates_are_compared_by_evidence_and_weight(finished):
    result = loaded(finished / "update.nc")
    found = result["compare/EXP"].to_dataset()
    assert found["model"].values.tolist() == ["[structure]", "one_spring"]
    evidence = found["log_evidence"].values
    assert evidence[0] == pytest.approx(result["EXP/sample_stats"].attrs["log_evidence"])
    weight = np.array([1.0, 2.0]) * np.exp(evidence - evidence.max())
    np.testing.assert_allclose(found["probability"], weight / weight.sum(), atol=1e-12)
    assert found.attrs["best"] == "[structure]"  # which the data were simulated with


@pytest.mark.slow
def test_findings_for_scripts(finished):
    found = json.loads((finished / "found.json").read_text())
    table = np.genfromtxt(finished / "table.csv", delimiter=",", names=True, dtype=None, encoding=None)
    assert found["explains"] and found["verdict"][0].startswith("The model explains the measurements")
    assert [row["mean"] for row in found["table"]] == pytest.approx(table["mean"].tolist())
    assert {"kind", "code", "text"} == set(found["findings"][0])
    assert any(doubt["code"] == "draws" for doubt in found["findings"])  # 100 draws of one chain


@pytest.mark.slow
def test_predict_reads_no_channel_and_samples_nothing(path, finished, monkeypatch, capsys):
    monkeypatch.setattr(sampling, "sample", None)
    text, data = path.read_text(), path.with_name("frame-measured.csv")
    hidden = data.rename(data.with_suffix(".hidden"))
    try:
        path.write_text(replaced(text, [("scale = 0.5", "peak = 6.0"), ('name = "half"', 'name = "six"')]))
        assert cli.main(["predict", str(path)]) == 0
        found = loaded(finished / "update.nc")["predict"]
        assert list(found.children) == ["six"]
        assert np.abs(found["six"]["ground_acceleration"]).max() == pytest.approx(6.0)
        assert "base shear" in capsys.readouterr().err
        html = (finished / "report.html").read_text()
        assert ">six</td>" in html and ">half</td>" not in html
        (older := path.with_name("older")).mkdir()
        xr.DataTree().to_netcdf(older / "update.nc", engine="h5netcdf")
        for changed, more, said in (
            (
                text.replace("[[predict]]", "[[predicts]]"),
                [],
                "`predicts` must be left out, it is no key. Did",
            ),
            (text.partition("[[predict]]")[0], [], "`predict` must be given, got none"),
            (text, ["--out", str(older)], "must hold the words of its report"),
            (text, ["--out", "nowhere"], "`--out` must hold the result of an update"),
        ):
            path.write_text(changed)
            assert cli.main(["predict", str(path), *more]) == 2
            assert said in capsys.readouterr().err
    finally:
        path.write_text(text)
        hidden.rename(data)


@pytest.mark.slow
def test_an_edited_prior_samples_what_it_changes(path, finished, monkeypatch, capsys):
    """That of the correlation time is one of CN-TAU alone; the result of before is moved aside."""
    sampled, draws = [], loaded(finished / "parts" / "EXP.nc")

    def noted(problem, kind, *rest):
        sampled.append(kind)
        posterior = draws["posterior"].to_dataset()
        if kind == "CN-TAU":
            posterior = posterior.assign(tau=0.02 + 0.0 * posterior["sigma"])
        return xr.DataTree.from_dict({"posterior": posterior, "sample_stats": draws["sample_stats"]})

    monkeypatch.setattr(sampling, "sample", noted)
    pairs = [
        ('kinds = ["EXP"]', 'kinds = ["EXP", "CN-TAU"]\ncorrelation_time = "tau"'),
        ("[priors]", '[priors]\ntau = { distribution = "Uniform", lower = 0.01, upper = 0.1 }'),
    ]
    other, out = path.with_name("other.toml"), path.with_name("other-output")
    other.write_text(replaced(path.read_text().partition("[[predict]]")[0], pairs))
    assert cli.main(["update", str(other), "--cores", "1"]) == 0
    assert sampled == ["EXP", "CN-TAU"]
    sampled.clear()
    other.write_text(other.read_text().replace("upper = 0.1 }", "upper = 0.2 }"))
    assert cli.main(["update", str(other), "--cores", "1"]) == 0
    assert sampled == ["CN-TAU"]
    told = capsys.readouterr().err
    assert f"`priors.tau.upper` changed: the result of before is kept in {out}-1, and EXP stays" in told
    assert (out.with_name("other-output-1") / "update.nc").exists()


@pytest.mark.slow
def test_what_sensors_see(path):
    """Every spring, but for noise that is 10,000 times larger, which hides all."""
    text = path.read_text().partition("[[predict]]")[0] + "\n[sensitivity]\ndraws = 5\n"
    seen = {}
    for name, value in (("quiet", '"sigma" '), ("noisy", '{ prior = "sigma", times = 1e4 } ')):
        other = path.with_name(f"{name}.toml")
        other.write_text(replaced(text, [('sigma = "sigma" ', f"sigma = {value}")]))
        seen[name] = remaining(read_problem(other))
    assert list(seen["quiet"]) == ["k1", "k2", "k3", "zeta"]
    assert all(0.0 < share < 0.9 for share, _ in seen["quiet"].values())
    assert all(share > 0.99 for share, _ in seen["noisy"].values())
    told = sensitivity_sentences(seen["noisy"])
    assert told[0].startswith("These sensors can hardly see k1 (100 %), k2 (100 %), k3 (100 %), zeta (100 %)")
    pair = seen["quiet"] | {"k2": (0.5, "k1")}
    assert sensitivity_sentences(pair)[-1] == "They can hardly tell apart k1 and k2."


ONE = 'stiffness = "k1" }'
BAD = {
    "`predict[0]` must have `limits` of its quantities": (
        "limits = { inter_storey_drift",
        "limits = { drift",
    ),
    "limit in SI units, or a list of limits, positive, got -1.0": ("[0.005, 1e3]", "-1.0"),
    "`predict[0]` must have a `scale` that is not 0, or a `peak`": ("scale = 0.5", "scale = 0.5\npeak = 3.0"),
    "`predict[0]` must have `dt` only with `path`, got no file": ("scale = 0.5", "dt = 0.5"),
    "`predict` must have a `name` of its own for each": (PREDICT, PREDICT + PREDICT),
    "`predict[0].path` must be the file with the ground acceleration": ("scale = 0.5", "path = 3"),
    "[compare.one_spring]: `structure.n` must be": (ONE, "n = -1 }"),
    "[compare.one_spring]: `structure.stiffness` must name": ('stiffness = "k1" }', 'stiffness = "k9" }'),
}


@pytest.mark.parametrize("said", BAD)
def test_bad_sections_name_the_key(path, tmp_path, said):
    changed = path.with_name("bad.toml")
    changed.write_text(replaced(path.read_text(), [BAD[said]]))
    with pytest.raises(ConfigError) as error:
        problem = read_problem(changed)
        candidates_of(problem)
    assert said in str(error.value)


@pytest.mark.processes
def test_all_typos_are_said_before_anything_is_imported(path, tmp_path):
    text = replaced(path.read_text(), [("[[predict]]", "[[predictt]]"), ("draws = 100", "drwas = 100")])
    (tmp_path / "typos.toml").write_text(text)
    code = (
        "import sys, time\nfrom pymc_features.update.config.keys import parsed\n"
        f"try: parsed({str(tmp_path / 'typos.toml')!r})\nexcept ValueError as error: print(error)\n"
        "print({'pymc', 'pytensor', 'numpy', 'pydantic'} & set(sys.modules), time.process_time() < 1.0)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert said.splitlines() == [
        "typos.toml: `sampler.drwas` must be left out, it is no key. Did you mean `draws`? `predictt` must "
        "be left out, it is no key. Did you mean `predict`?",
        "set() True",
    ]
    assert keys.parsed(path)["predict"][0]["scale"] == 0.5


def test_one_update_in_a_folder_at_a_time(tmp_path):
    """Another process is named; one that was killed holds nothing."""
    code = (
        "import sys, time\nfrom pymc_features.storage import held\n"
        f"with held({str(tmp_path)!r}, 'update'):\n    print('held', flush=True)\n    time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with (
            pytest.raises(StudyMismatchError, match=f"which process {other.pid}, started at 2"),
            held(tmp_path, "update"),
        ):
            pass
        other.kill()
    with held(tmp_path, "update"):
        pass


@pytest.mark.processes
def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path):
    """Files of at most 4 kB stand for a disk that is full: part and checkpoint."""
    resource = pytest.importorskip("resource")
    code = (
        "import resource, signal, sys\nimport numpy as np\nimport xarray as xr\n"
        "from pymc_features.smc.kernels.checkpoint import Journal\n"
        "from pymc_features.storage import PartStore\nfrom pathlib import Path\n"
        f"folder = Path({str(tmp_path)!r})\nstore = PartStore(folder, {{}})\n"
        "small, large = (xr.DataTree(xr.Dataset({'x': ('i', np.random.rand(n))})) for n in (3, 10**5))\n"
        "store.save('small', small)\njournal = Journal(folder / 'a.journal')\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (8000, 8000))\n"
        "for work in (lambda: store.save('large', large),\n"
        "             lambda: journal.write(np.ones((2000, 2)), (np.ones(2000),) * 3)):\n"
        "    try: work()\n    except OSError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and resource.RLIMIT_FSIZE, done.stderr
    part, journal = done.stdout.splitlines()
    assert part.startswith(f"`{tmp_path}/parts/large.nc` could not be written, for the disk is full")
    assert journal.startswith(f"`{tmp_path}/a.journal` could not be written, for the disk is full")
    assert sorted(os.listdir(tmp_path / "parts")) == ["small.nc", "small.sha256"]
    assert PartStore(tmp_path, {}).load("small")["x"].sizes == {"i": 3}
