"""Updating with identified modes, alone and with responses: messages, exact posteriors, the report."""

import json
import re
import shutil

import numpy as np
import pytest
import scipy.stats
import xarray as xr

from pymc_features import ModalDamping, SpringMassChain, cli, simulate, synthetic_earthquake
from pymc_features.exceptions import ConfigError
from pymc_features.update import read_problem, run_update, sampling
from pymc_features.update.kinds.base import declare
from pymc_features.update.kinds.modal import ModeRow, modes_verdict
from support.report_pages import words

MASS, DRAWN, TRUE = 1.6e5, np.array([3.4e8, 3.0e8, 2.5e8]), {"k1": 0.8, "k2": 1.0, "k3": 1.1}
NAMES = ["floor 1", "floor 2", "roof"]
MODAL = """
[modal]
file = "modes.csv"
channels = { "floor 1" = 0, "floor 2" = 1, roof = 2 }
sigma_f = 0.005
sigma_phi = 0.03
"""
STRUCTURE = """
[structure]
type = "SpringMassChain"
mass = 1.6e5
stiffness = { groups = [["k1", 1], ["k2", 1], ["k3", 1]], times = [3.4e8, 3.0e8, 2.5e8] }

[priors]
k1 = { distribution = "LogNormal", mu = 0.0, sigma = 0.25 }
k2 = { distribution = "LogNormal", mu = 0.0, sigma = 0.25 }
k3 = { distribution = "LogNormal", mu = 0.0, sigma = 0.25 }
"""
DATA = """
sigma = { distribution = "HalfNormal", sigma = 0.5 }

[data]
files = "acceleration.csv"
units = "m/s^2"
base = "base"
sensors = ["first", "top"]
dofs = [0, 2]

[likelihood]
kinds = ["EXP"]
sigma = "sigma"
"""
SAMPLER = """
[sampler]
draws = 200
cores = 1
"""


def modes_of(k1, k2, k3):
    """Frequencies and shapes (mode, dof) by the structure of the package."""
    found = SpringMassChain([MASS] * 3, DRAWN * [k1, k2, k3], ModalDamping(0.02)).modes()
    return found.natural_frequencies, found.mode_shapes.T


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Modes and accelerations of the true chain, with errors."""
    folder = tmp_path_factory.mktemp("modal")
    rng, (frequencies, shapes) = np.random.default_rng(6), modes_of(**TRUE)
    frequencies = frequencies * np.exp(0.004 * rng.normal(size=3))
    shapes = 100.0 * shapes + 0.004 * rng.normal(size=(3, 3))
    lines = ["frequency [Hz],frequency_sd [Hz],damping [%],floor 1,floor 2,roof"]
    for f, shape in zip(frequencies, shapes, strict=True):
        lines.append(f"{f:.6f},{0.002 * f:.6f},1.5,{','.join(f'{x:.6f}' for x in shape)}")
    (folder / "modes.csv").write_text("\n".join(lines) + "\n")
    (folder / "bare.csv").write_text("frequency\n" + "\n".join(f"{f:.6f}" for f in frequencies) + "\n")
    (folder / "hole.csv").write_text(
        "\n".join([*lines[:2], lines[2].rpartition(",")[0] + ",", lines[3]]) + "\n"
    )
    (folder / "m.toml").write_text(MODAL + STRUCTURE + SAMPLER)
    record = synthetic_earthquake(6.0, 0.01, random_seed=3, pga=2.0)
    chain = SpringMassChain([MASS] * 3, DRAWN * list(TRUE.values()), ModalDamping(0.02))
    floors = simulate(chain, record, sensors=[0, 2]).values
    floors = floors + 0.1 * floors.std() * rng.normal(size=floors.shape)
    table = np.column_stack([record.time, record.acceleration, *floors])
    np.savetxt(folder / "acceleration.csv", table, delimiter=",", header="time,base,first,top", comments="")
    return folder


def write(folder, name, text):
    path = folder / f"{name}.toml"
    path.write_text(text)
    return path


def with_damping(text):
    return text.replace("mass = 1.6e5", 'mass = 1.6e5\ndamping = { type = "ModalDamping", ratios = 0.02 }')


# ---- messages ----

PHI = "sigma_phi = 0.03"
CHANNELS = 'channels = { "floor 1" = 0, "floor 2" = 1, roof = 2 }'
WITH_ABC = DATA.replace('"EXP"', '"EXP", "ABC"').partition("\n\n")[2].replace('"sigma"', "0.1")
BROKEN = {  # what is said: what is changed, into what
    "`data` must be given: a table with the files of measured responses. Or give identified": (MODAL, ""),
    "`modal` must have one of the keys `file` and `files`, got both or neither": ('file = "modes.csv"', ""),
    "`modal` must have `references` only with `files`, got them with": (PHI, f'{PHI}\nreferences = ["roof"]'),
    "`modal.files` must be a list of files, two or more,": ('file = "modes.csv"', 'files = ["modes.csv"]'),
    "[modal]: `file` must be an existing file, got": ('"modes.csv"', '"nothing.csv"'),
    "`modal.sigma_f` must be given: the name of a prior or a number, one or one for": ("sigma_f = 0.005", ""),
    "`modal.sigma_phi` must be given with the shapes of modes.csv, got none. Pass the scale": (PHI, ""),
    "`modal.sigma_phi` must be positive, got 0. 0.01 is an error of one per cent.": (PHI, "sigma_phi = 0.0"),
    "`modal.sigma_f` must be at least zero, got -0.1": ("sigma_f = 0.005", "sigma_f = -0.1"),
    "`modal.channels` must be given with shapes: a table of channel names to degrees of freedom. modes.csv "
    "has floor 1, floor 2, roof. Or set shapes = false.": (CHANNELS, ""),
    "[modal]: `channels` must be among those of these modes (floor 1, floor 2,": ("roof = 2", "attic = 2"),
    "`modal.channels` must be different degrees of freedom from 0 to 2, 0 next to the base, got [0,": (
        "roof = 2",
        "roof = 3",
    ),
    "`modal.channels` must be two or more, for a shape of one entry": (CHANNELS, "channels = { roof = 2 }"),
    "`modal.modes` must be different numbers from 1 to 3, the modes of": (PHI, f"{PHI}\nmodes = [0, 1]"),
    "`modal.labels` must have a name for each of the 3 modes, got 2.": (PHI, f'{PHI}\nlabels = ["a", "b"]'),
    "`modal.n_modes` must be from the 3 modes identified to the 3 of the": (PHI, f"{PHI}\nn_modes = 2"),
    "`modal.scale` must have factors that are not zero for": (PHI, f"{PHI}\nscale = {{ attic = -1.0 }}"),
    "`modal.channels` must be a table of channel names to degrees of freedom,": ("roof = 2", 'roof = "top"'),
    "`modal` must have positive degrees of freedom as `density`, got -1": (PHI, f"{PHI}\ndensity = -1.0"),
    '`modal.density` must be "EXP", "TN", "NORMAL" or degrees of freedom,': (
        PHI,
        f'{PHI}\ndensity = "GAMMA"',
    ),
    "`structure.damping` must be given": (PHI, f"{PHI}\nsigma_zeta = 0.2"),
    "`modal.sigma_phi` must be left out without shapes, got it. It says shapes": (CHANNELS, "shapes = false"),
    "`modal.channels` must be left out without shapes, got it. bare.csv has": ('"modes.csv"', '"bare.csv"'),
    "[modal]: modes.csv": ('file = "modes.csv"', 'file = "modes.csv"\nnames = { omega = "frequency" }'),
    "`processing` must be left out without [data], got it.": (SAMPLER, "[processing]\ndecimate = 1"),
    "`likelihood` must be left out without [data],": (SAMPLER, '[likelihood]\nkinds = ["EXP"]\nsigma = 0.1'),
    "`report.quantities` must be left out without": (SAMPLER, '[report]\nquantities = ["base_shear"]'),
    "`likelihood` must be given with [data]: a table.": (SAMPLER, DATA.split("\n\n")[1]),
    "`likelihood.kinds` must not have ABC with [modal], for a tolerance on responses": (SAMPLER, WITH_ABC),
    "`priors.modal_mode` must have a name of letters, digits and underscores": ("k1 = {", "modal_mode = {"),
    "`modal.nodes` must be an existing file, got": (PHI, f'{PHI}\nnodes = "nowhere.csv"'),
}


@pytest.mark.parametrize("message", BROKEN)
def test_broken_configurations_name_the_key(folder, capsys, message):
    old, new = BROKEN[message]
    text = MODAL + STRUCTURE + SAMPLER
    assert text.count(old) == 1, old
    text = text.replace(old, new)
    if "[data]" in new:
        text = with_damping(text)
    assert cli.main(["update", str(write(folder, "broken", text))]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert not (folder / "broken-output").exists()


NODES = {  # what is said: the file
    "columns dof or name, x, y, z, and perhaps direction and line, got 'dof, height'": "dof,height\n0,1\n",
    "must have a column x, y or z, got none": "dof,line\n0,1\n",
    "line 3: `dof` must be a whole number from 0 to 2, or empty where a node is held": "dof,z\n0,1\n3,1\n",
    "line 2: `z` must be a number in m, got 'high'": "dof,z\n0,high\n",
    "line 2: `name` must be one of the channels floor 1, floor 2, roof, got 'attic'": "name,z\nattic,1\n",
    "line 2: `direction` must be x, y, z or -x, -y, -z, got 'up'": "dof,z,direction\n0,1,up\n",
    "must have a row for every channel, nodes.csv has none for roof (degree of": "dof,z\n0,1\n1,2\n",
}


@pytest.mark.parametrize("message", NODES)
def test_broken_files_of_nodes_name_the_line(folder, message):
    (folder / "nodes.csv").write_text(NODES[message])
    path = write(folder, "nodes", (MODAL + STRUCTURE).replace(PHI, f'{PHI}\nnodes = "nodes.csv"'))
    with pytest.raises(ConfigError, match=f"`modal.nodes`.*{re.escape(message)}"):
        read_problem(path)


# ---- what is read ----


def test_modes_channels_and_signs_are_those_asked_for(folder):
    more = f'{PHI}\nmodes = [3, 1]\nscale = {{ roof = -2.0 }}\nlabels = ["a", "b"]'
    text = (MODAL + STRUCTURE).replace(PHI, more).replace(CHANNELS, 'channels = { roof = 2, "floor 1" = 0 }')
    modal = read_problem(write(folder, "chosen", text)).modal
    table = np.genfromtxt(folder / "modes.csv", delimiter=",", skip_header=1)
    np.testing.assert_allclose(modal.data.frequencies, table[[2, 0], 0])
    np.testing.assert_allclose(modal.data.shapes, table[[2, 0]][:, [5, 3]] * [-2.0, 1.0])
    assert (modal.dofs, modal.names, modal.n_modes) == ([2, 0], ["3 (a)", "1 (b)"], 3)


def test_setups_are_merged(folder):
    frequencies, shapes = modes_of(**TRUE)
    for name, dofs, factor in (("one", [0, 2], 1.0), ("two", [2, 1], -3.0)):
        header = ",".join(["frequency", *(NAMES[dof] for dof in dofs)])
        rows = np.column_stack([frequencies, factor * shapes[:, dofs]])
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=header, comments="")
    text = MODAL.replace('file = "modes.csv"', 'files = ["one.csv", "two.csv"]\nreferences = ["roof"]')
    modal = read_problem(write(folder, "setups", text + STRUCTURE)).modal
    np.testing.assert_allclose(
        modal.data.shapes / modal.data.shapes[:, :1], shapes / shapes[:, :1], rtol=1e-9
    )
    text = text.replace('["roof"]', '["attic"]')
    with pytest.raises(ConfigError, match=r"\[modal\]: `references` must be among those of several"):
        read_problem(write(folder, "setups", text + STRUCTURE))


def test_nodes_of_a_file(folder):
    rows = ",0,0,,mast", "0,0,4,x,mast", "2,0,12,-x,mast", "1,0,8,x,other", "0,0,4,x,other"
    (folder / "nodes.csv").write_text("\n".join(["dof,x,z,direction,line", *rows]) + "\n")
    path = write(folder, "nodes", (MODAL + STRUCTURE).replace(PHI, f'{PHI}\nnodes = "nodes.csv"'))
    points = read_problem(path).modal.nodes
    assert points.dofs.tolist() == [-1, 0, 2, 1]
    assert points.nodes["lines"] == [[0, 1, 2], [3, 1]]
    assert points.nodes["directions"][2] == (-1.0, 0.0, 0.0)
    np.testing.assert_array_equal(points.entries(np.array([[5.0, 6.0, 7.0]])), [[0.0, 5.0, 7.0, 6.0]])
    assert points.of([2, 0]) == [2, 1]


# ---- posteriors ----


def test_frequencies_alone_have_a_gaussian_posterior(folder):
    """ln f^ = ln f_0 + ln theta / 2 + an error of known size: ln theta is conjugate, two draws apart."""
    text = MODAL.replace("modes.csv", "bare.csv").replace(CHANNELS, "").replace(PHI, "")
    text += STRUCTURE.partition("stiffness")[0]
    text += 'stiffness = { prior = "k", times = [3.4e8, 3.0e8, 2.5e8] }\n\n[priors]\n'
    text += 'k = { distribution = "LogNormal", mu = 0.0, sigma = 0.25 }\n' + SAMPLER.replace("200", "1000")
    problem = read_problem(write(folder, "bare", text.replace("0.005", "[0.005, 0.01, 0.02]")))
    result = run_update(problem, cores=1, progressbar=False)
    z = np.log(np.loadtxt(folder / "bare.csv", skiprows=1)) - np.log(modes_of(1.0, 1.0, 1.0)[0])
    weights = 0.25 / np.array([0.005, 0.01, 0.02]) ** 2  # of (d ln f / d ln theta)^2 = 1 / 4
    precision = weights.sum() + 0.25**-2
    mean = (weights * 2.0 * z).sum() / precision
    draws = np.log(result["MODAL/posterior"]["k"].values)
    # the mean of 2000 draws is off by 4 standard errors once in 16,000 times
    assert abs(draws.mean() - mean) < 4.0 * precision**-0.5 / np.sqrt(2000)
    assert abs(draws.std() * precision**0.5 - 1.0) < 4.0 / np.sqrt(4000)
    assert "shape" not in result["identified"]


def test_damping_ratios_have_a_gaussian_posterior(folder):
    """ln zeta^ = ln zeta + an error of 0.3 in each of three modes: ln zeta is conjugate, two draws apart."""
    text = MODAL.replace("sigma_f = 0.005", "sigma_f = 0.005\nsigma_zeta = 0.3")
    text += STRUCTURE.replace("mass =", 'damping = { type = "ModalDamping", ratios = "zeta" }\nmass =')
    text += 'zeta = { distribution = "LogNormal", mu = -4.0, sigma = 0.5 }\n' + SAMPLER.replace("200", "1000")
    result = run_update(read_problem(write(folder, "damped", text)), cores=1, progressbar=False)
    precision = 3.0 / 0.3**2 + 0.5**-2
    mean = (3.0 / 0.3**2 * np.log(0.015) + 0.5**-2 * -4.0) / precision
    draws = np.log(result["MODAL/posterior"]["zeta"].values)
    # the mean of 2000 draws is off by 4 standard errors once in 16,000 times
    assert abs(draws.mean() - mean) < 4.0 * precision**-0.5 / np.sqrt(2000)
    assert abs(draws.std() * precision**0.5 - 1.0) < 4.0 / np.sqrt(4000)


def test_damping_ratios_must_be_in_the_file(folder):
    text = MODAL.replace("modes.csv", "bare.csv").replace(CHANNELS, "").replace(PHI, "sigma_zeta = 0.2")
    with pytest.raises(ConfigError, match="`modal.sigma_zeta` must be left out .*, bare.csv has none"):
        read_problem(write(folder, "undamped", text + with_damping(STRUCTURE)))


@pytest.fixture(scope="module")
def finished(folder):
    """The modes alone, by the command."""
    assert cli.main(["update", str(folder / "m.toml")]) == 0
    return folder / "m-output"


@pytest.mark.slow
def test_posterior_has_the_truth_and_the_report_its_numbers(finished, folder):
    table = np.genfromtxt(folder / "modes.csv", delimiter=",", skip_header=1)
    html = words((finished / "report.html").read_text())
    with xr.open_datatree(finished / "update.nc", engine="h5netcdf") as tree:
        posterior, matched = tree["MODAL/posterior"].to_dataset(), tree["MODAL/matched"].to_dataset()
        for name, value in TRUE.items():  # 99.9 %: by chance once in 300 seeds
            low, high = np.quantile(posterior[name], [0.0005, 0.9995])
            assert low < value < high
        own = [modes_of(*(float(posterior[k][0, d]) for k in TRUE)) for d in matched["draw"].values[:5]]
        assert (matched["model_mode"].values == [0, 1, 2]).all()
        for d, (frequencies, shapes) in enumerate(own):
            np.testing.assert_allclose(matched["frequency"][:, d].sel(chain=0), frequencies, rtol=1e-8)
            for k in range(3):
                a, b = shapes[k], table[k, 3:]
                mac = (a @ b) ** 2 / (a @ a) / (b @ b)
                assert float(matched["mac"].sel(chain=0)[d, k]) == pytest.approx(mac, rel=1e-8)
        low, middle, high = np.quantile(matched["frequency"].sel(identified=2), [0.05, 0.5, 0.95])
        decimals = 1 - int(np.floor(np.log10((high - low) / 3.29)))  # two digits of the standard deviation
        cells = [f"{table[1, 0]:.4g}", *(f"{v:.{decimals}f}" for v in (low, middle, high))]
        cells.append(f"{100 * (middle / table[1, 0] - 1):+.2f} %")
        assert "".join(f"<td>{cell}</td>" for cell in cells) in html
        assert "observed_data" not in tree["MODAL"].children and "data" not in tree.children
    assert "updated with 3 identified modes, 3 uncertain parameters, under MODAL.</p>" in html
    assert "The model has a partner for all 3 identified modes" in html
    assert re.search(r"The data changed k\d \(0\.\d\d\), ", html)
    assert "Data used" in html and "measured accelerations" not in html
    figures = {path.stem for path in (finished / "figures").iterdir()}
    assert {"MODAL_mac", "MODAL_shapes", "MODAL_prior_posterior"} <= figures
    assert not figures & {"record", "frequencies", "MODAL_response"}
    settings = json.loads((finished / "update.json").read_text())
    assert "modal_shapes_sha256" in settings and "channels_sha256" not in settings


@pytest.mark.slow
def test_other_nodes_sample_nothing_other_modes_all(finished, folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sampling, "sample", None)
    out = tmp_path / "copy"
    shutil.copytree(finished, out)
    (folder / "nodes.csv").write_text("name,z\n,0\nfloor 1,4\nfloor 2,8\nroof,12\n")
    path = write(folder, "m2", (folder / "m.toml").read_text().replace(PHI, f'{PHI}\nnodes = "nodes.csv"'))
    assert cli.main(["update", str(path), "--out", str(out)]) == 0
    with xr.open_datatree(out / "update.nc", engine="h5netcdf") as tree:
        assert tree["MODAL/mode_shapes"].sizes["point"] == 4
    path.write_text(path.read_text().replace(PHI, f"{PHI}\nscale = {{ roof = 1.1 }}"))
    with pytest.raises(TypeError, match="not callable"):
        cli.main(["update", str(path), "--out", str(out), "--traceback"])
    assert "`modal.scale.roof`, `modal_shapes_sha256` changed: the result" in capsys.readouterr().err
    assert (tmp_path / "copy-1" / "update.nc").exists()


def logp_of(problem, kind, point):
    """Log-posterior density up to the Jacobian of transforms, at values of the priors."""
    model = declare(problem, kind)
    values = {}
    for rv in model.free_RVs:
        transform = model.rvs_to_transforms[rv]
        value = model.rvs_to_values[rv]
        values[value.name] = transform.forward(point[rv.name]).eval() if transform else point[rv.name]
    terms = model.compile_logp(sum=False, jacobian=False, mode="FAST_COMPILE")(values)
    return float(sum(np.sum(term) for term in terms))


@pytest.mark.slow
def test_responses_and_modes_are_one_model(folder):
    """Its log-density is that of responses and that of modes, with one prior; CAL's is that of NORM."""
    rest = with_damping(STRUCTURE) + DATA
    texts = {"both": MODAL + rest, "data": rest, "modes": MODAL + STRUCTURE}
    problems = {name: read_problem(write(folder, name, text)) for name, text in texts.items()}
    point = {"k1": 0.82, "k2": 1.01, "k3": 1.08, "sigma": 0.2}
    prior = sum(scipy.stats.lognorm(0.25).logpdf(point[name]) for name in TRUE)
    both = logp_of(problems["both"], "EXP", point)
    parts = logp_of(problems["data"], "EXP", point) + logp_of(problems["modes"], "MODAL", point) - prior
    assert both == pytest.approx(parts, rel=1e-7)
    assert logp_of(problems["both"], "CAL", point) == pytest.approx(
        logp_of(problems["both"], "NORM", point), rel=1e-7
    )
    assert both != pytest.approx(logp_of(problems["data"], "EXP", point), rel=1e-3)


# ---- what is said ----


@pytest.mark.slow
def test_a_mode_without_partner_and_a_missing_entry(folder, capsys):
    """The third mode moves as a rigid body would; the roof of the second was not measured."""
    lines = (folder / "hole.csv").read_text().splitlines()
    lines[3] = ",".join([*lines[3].split(",")[:3], "1.0", "1.0", "1.0"])
    (folder / "stranger.csv").write_text("\n".join(lines) + "\n")
    text = (folder / "m.toml").read_text().replace("modes.csv", "stranger.csv")
    text = text.replace("draws", 'method = "laplace"\ndraws')
    path = write(folder, "stranger", text.replace(PHI, "sigma_phi = 0.3"))
    assert cli.main(["update", str(path)]) == 0
    told = capsys.readouterr().err
    assert (
        "The model has no partner for the identified mode 3 (12.05 Hz): the best that is left is at" in told
    )
    assert "The model has a partner for 2 of 3 identified modes" in told
    row = next(line for line in told.splitlines() if re.match(r"\s*3 +12.05 ", line))
    assert row.split()[-1] == "none"
    with xr.open_datatree(folder / "stranger-output" / "update.nc", engine="h5netcdf") as tree:
        assert np.isnan(tree["identified"]["shape"].values[1, 2])
        assert float(tree["MODAL/matched"]["has_partner"].sel(identified=3).mean()) < 0.05


def test_verdict_on_modes():
    row = ModeRow("1", 2.0, (1.98, 2.02, 2.05), (0.97, 0.98, 0.99), 1, 1.0, 0.0)
    other = row._replace(
        name="2", measured=5.0, model=(4.9, 5.0, 5.1), mac=(np.nan,) * 3, partner=3, share=0.6
    )
    said, explains = modes_verdict([row, other])
    assert explains
    assert said == [
        "The model has a partner for all 2 identified modes: the median frequency is off by at most 1 % "
        "(mode 1), the MAC is at least 0.980 (mode 1).",
        "The identified mode 2 takes f3 in 60 % of the draws, and others in the rest: they change places, or "
        "the data cannot tell them apart.",
    ]
    said, explains = modes_verdict([row._replace(strangers=0.9)])
    assert not explains
    assert said == [
        "The model has no partner for the identified mode 1 (2 Hz): the best that is left is at 2.02 Hz, MAC "
        "0.98."
    ]


@pytest.mark.slow
def test_check_draws_what_there_is(folder, capsys, monkeypatch):
    monkeypatch.setattr(sampling, "sample", None)
    path = write(folder, "both", MODAL + with_damping(STRUCTURE) + DATA)
    assert cli.main(["check", str(path)]) == 0
    assert "modes: 3 modes at 3 channels from modes.csv" in capsys.readouterr().err
    for name in ("both-check.png", "both-check-modes.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    stiff = (MODAL + STRUCTURE).replace("3.4e8, 3.0e8, 2.5e8", "9e8, 9e8, 9e8").replace(PHI, "")
    stiff = stiff.replace("modes.csv", "bare.csv").replace(CHANNELS, "")
    assert cli.main(["check", str(write(folder, "stiff", stiff))]) == 0
    assert "Outside of what the priors expect (5 to 95 %): 1 (" in capsys.readouterr().err
    assert not (folder / "stiff-check.png").exists()
