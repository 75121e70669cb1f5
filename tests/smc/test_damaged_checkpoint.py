"""Checkpoints with every file damaged: a plain refusal that names it, or the particles of an intact run."""

import json
import zlib

import numpy as np
import pymc as pm
import pytest

from pymc_features import PopulationIMH, sample, sample_smc
from pymc_features.exceptions import CheckpointError
from pymc_features.smc.kernels.checkpoint import read_json, remembered
from support.mutations import mutated
from support.sampling import QUIET

MUTATIONS = 12  # of each file
OTHER_JSON = [
    "",
    "[]",
    "null",
    "3",
    '"seed"',
    "{}",
    '{"chains": 2}',
    '{"random_seed": [], "chains": 1}',
    "[" * 10**5,
]


def model_of(data=0.5):
    """One parameter, measured."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0, shape=2)
        pm.Normal("y", x, 0.3, observed=[data, -0.5])
    return model


def particles(model, folder, how=sample_smc):
    """Of one chain."""
    settings = {"kernel": PopulationIMH, **QUIET} if how is sample_smc else {"progressbar": False}
    idata = how(60, model=model, checkpoint=folder, chains=1, cores=1, random_seed=5, **settings)
    return idata.posterior["x"].values


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A model, the files of a run of it, and its particles."""
    folder, model = tmp_path_factory.mktemp("checkpoint"), model_of()
    draws = particles(model, folder)
    return model, {path.name: path.read_bytes() for path in folder.iterdir()}, draws


def written(files, folder):
    """A folder with these files."""
    folder.mkdir(exist_ok=True)
    for name, raw in files.items():
        (folder / name).write_bytes(raw)
    return folder


def continued(finished, folder, name):
    """Whether a run goes on, to the same particles; or is refused, with the name of the file."""
    model, _, expected = finished
    try:
        draws = particles(model, folder)
    except CheckpointError as error:
        assert name in str(error)
        assert "Choose another folder, or remove this one to begin anew." in str(error)
        return False
    np.testing.assert_array_equal(draws, expected)
    return True


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["seed.json", "run.json", ".journal"])
def test_damaged_files(finished, tmp_path, kind):
    """Bytes at random; all of them, half of them, and none."""
    files = finished[1]
    [name] = [name for name in files if name.endswith(kind)]
    raw, rng = files[name], np.random.default_rng(zlib.crc32(kind.encode()))
    copies = [mutated(raw, rng)[0] for _ in range(MUTATIONS)]
    copies += [b"", raw[: len(raw) // 2], rng.bytes(len(raw)), raw + rng.bytes(100)]
    refused = sum(
        not continued(finished, written({**files, name: copy}, tmp_path / f"{k}"), name)
        for k, copy in enumerate(copies)
    )
    assert refused > MUTATIONS // 2


@pytest.mark.parametrize("text", OTHER_JSON)
@pytest.mark.parametrize("name", ["seed.json", "run.json"])
def test_json_of_another_kind(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(CheckpointError, match=f"`checkpoint` must be intact, got .*{name}: .*Choose another"):
        read_json(tmp_path / name)


def test_a_seed_that_was_edited(finished, tmp_path):
    content = json.loads(finished[1]["seed.json"])
    (tmp_path / "seed.json").write_text(json.dumps(content | {"chains": 3}))
    with pytest.raises(CheckpointError, match="`checkpoint` must be intact, got .*seed.json: a wrong sum"):
        remembered(tmp_path, None, None, 4)


def test_a_journal_of_another_model_is_refused(finished, tmp_path):
    """With the same seed and prior, so of the same first particles: the likelihoods would be wrong."""
    _, files, draws = finished
    other = model_of(0.9)
    own = particles(other, tmp_path / "other")
    assert not np.array_equal(own, draws)
    [name] = [name for name in files if name.endswith(".journal")]
    (tmp_path / "other" / name).write_bytes(files[name])
    with pytest.raises(
        CheckpointError, match=f"got a wrong sum in .*{name}: it is damaged, or of another run"
    ):
        particles(other, tmp_path / "other")


@pytest.mark.slow
def test_the_search_for_modes_of_another_model_is_refused(tmp_path):
    """Though nothing but that search was done."""
    particles(model_of(), tmp_path / "whole", sample)
    raw = (tmp_path / "whole" / "modes.record").read_bytes()
    seed = (tmp_path / "whole" / "seed.json").read_bytes()
    folder = written({"modes.record": raw, "seed.json": seed}, tmp_path / "stopped")
    particles(model_of(), folder, sample)
    folder = written({"modes.record": raw, "seed.json": seed}, tmp_path / "other")
    with pytest.raises(
        CheckpointError, match="got a wrong sum in .*modes.record: it is damaged, or of another"
    ):
        particles(model_of(0.9), folder, sample)
