"""Folders with finished parts, damaged: a plain refusal, the part as it was, or one that is sampled again."""

import json
import re
import shutil
import zlib

import numpy as np
import pytest
import xarray as xr

from pymc_features.exceptions import StudyMismatchError
from pymc_features.storage import PartStore, remove_parts
from pymc_features.study.sampling_rate import seed_in
from support.mutations import mutated

MUTATIONS = 20  # of each file
SETTINGS = {"draws": 100, "random_seed": 3, "multipliers": [0.5, 1.0], "record": "pulse"}
NAMES = "NORM_x1", "TN_x1"
JSON = ["", "[]", "null", "3", '"draws"', "[[]]", "{}", '{"draws": 100}', "{" * 10**5, "[" * 10**5, "\udcff"]


def part(name):
    """Draws that the name decides."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    draws = xr.Dataset({"theta": (("chain", "draw"), rng.normal(size=(2, 50)))})
    tree = xr.DataTree.from_dict({"posterior": draws, "sample_stats": xr.Dataset(attrs={"ess": 90.0})})
    tree.attrs["seconds"] = 1.0
    return tree


@pytest.fixture
def folder(tmp_path):
    """A folder with two finished parts."""
    store = PartStore(tmp_path / "out", SETTINGS)
    for name in NAMES:
        store.save(name, part(name))
    return tmp_path / "out"


def parts_in(folder, settings=SETTINGS):
    """What a run that continues gets; None for a part that it must sample."""
    store = PartStore(folder, settings)
    return {name: store.load(name) for name in NAMES}


def continued(folder):
    """Whether a run continues: with the parts as they were; or is refused, with the name of the file."""
    try:
        found = parts_in(folder)
    except StudyMismatchError as error:
        assert str(folder) in str(error)
        assert re.search("[Dd]elete th|or delete", str(error))
        assert len(str(error)) < 1000
        return False
    for name, tree in found.items():
        if tree is not None:
            xr.testing.assert_identical(tree, part(name))
    return True


def test_finished_parts_are_found(folder):
    assert all(tree is not None for tree in parts_in(folder).values())
    assert continued(folder)


@pytest.mark.parametrize("name", ["study.json", "parts/NORM_x1.nc", "parts/TN_x1.sha256"])
def test_damaged_files(folder, name):
    """Bytes at random; all of them, half of them, and none."""
    path = folder / name
    raw, rng, refused = path.read_bytes(), np.random.default_rng(zlib.crc32(name.encode())), 0
    copies = [mutated(raw, rng)[0] for _ in range(MUTATIONS)]
    for copy in [b"", raw[: len(raw) // 2], rng.bytes(len(raw)), raw + b"\0", *copies]:
        path.write_bytes(copy)
        refused += not continued(folder)
    assert refused > MUTATIONS // 2


@pytest.mark.parametrize("text", JSON)
def test_settings_of_another_kind(folder, text):
    (folder / "study.json").write_text(text, errors="surrogateescape")
    with pytest.raises(StudyMismatchError, match="`out` must be empty or hold the same study, got .*elete"):
        parts_in(folder)


def test_a_seed_is_not_taken_from_damaged_settings(folder):
    assert seed_in(folder) == 3
    for seed in (-3, 3.5, "3", None, [3]):
        (folder / "study.json").write_text(json.dumps(SETTINGS | {"random_seed": seed}))
        assert seed_in(folder) is None
    (folder / "study.json").write_text("[]")
    with pytest.raises(StudyMismatchError, match="study.json, which is damaged: no table but a list. Choose"):
        seed_in(folder)


DAMAGED = "`out` must hold parts of this study as they were written, got .*{}.nc, which is damaged"


def swap(folder, suffix):
    """Exchange files of the two parts."""
    first, second = (folder / "parts" / f"{name}{suffix}" for name in NAMES)
    kept = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(kept)


@pytest.mark.parametrize("suffixes", [[".nc"], [".sha256"], [".nc", ".sha256"]])
def test_swapped_parts_are_refused(folder, suffixes):
    for suffix in suffixes:
        swap(folder, suffix)
    with pytest.raises(StudyMismatchError, match=DAMAGED.format("NORM_x1") + r".*\(wrong sum\). Delete this"):
        parts_in(folder)


def test_parts_of_another_study_are_refused(folder, tmp_path):
    other = SETTINGS | {"draws": 200}
    PartStore(tmp_path / "other", other)
    shutil.copytree(folder / "parts", tmp_path / "other" / "parts", dirs_exist_ok=True)
    with pytest.raises(StudyMismatchError, match=DAMAGED.format("NORM_x1")):
        parts_in(tmp_path / "other", other)


def test_a_part_without_a_sum_is_sampled_again_but_in_an_older_folder(folder):
    (folder / "parts" / "TN_x1.sha256").unlink()
    assert [tree is None for tree in parts_in(folder).values()] == [False, True]
    (folder / "study.json").write_text(json.dumps(SETTINGS))
    assert [tree is None for tree in parts_in(folder).values()] == [False, False]
    (folder / "parts" / "TN_x1.nc").write_bytes(b"no netCDF")
    with pytest.raises(StudyMismatchError, match=DAMAGED.format("TN_x1")):
        parts_in(folder)


def test_a_part_that_is_written_anew(folder):
    store = PartStore(folder, SETTINGS)
    store.save("TN_x1", part("other"))
    xr.testing.assert_identical(store.load("TN_x1"), part("other"))


def test_what_is_no_folder(folder):
    with pytest.raises(OSError, match="`out` must be a folder that can be written, got .*study.json"):
        PartStore(folder / "study.json", SETTINGS)
    (folder / "parts" / "TN_x1.nc").unlink()
    (folder / "parts" / "TN_x1.nc").mkdir()
    with pytest.raises(StudyMismatchError, match=DAMAGED.format("TN_x1")):
        parts_in(folder)


def test_starting_anew_deletes_parts_and_settings_and_nothing_else(folder):
    (folder / "report.html").write_text("mine")
    (folder / "parts" / "notes.txt").write_text("mine")
    with pytest.raises(StudyMismatchError, match="delete this one .--force on the command line"):
        PartStore(folder, SETTINGS | {"draws": 200})
    assert remove_parts(folder, "study") == 2
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert left == ["parts/notes.txt", "report.html"]
    store = PartStore(folder, SETTINGS | {"draws": 200})
    assert store.load(NAMES[0]) is None
    assert remove_parts(folder / "none", "study") == 0
