"""Damaged copies of configurations: each is refused in a sentence that says why, or its model stands.

`MUTATIONS` copies by a fixed seed. A longer run, without pytest: `mutate(folder, seed, 5000)`.
"""

import copy
import re
import shutil
import time
import tomllib
import warnings

import numpy as np
import pytest

from pymc_features.exceptions import ConfigError
from pymc_features.update import read_problem, sampling, write_example
from pymc_features.update.kinds.base import declare
from support.config_mutations import as_toml, mutated_config, pick
from support.memory import peak

MUTATIONS = 30
SECONDS = 2.0  # of the processor
MEMORY = 300_000_000  # bytes, for all of them
ROWS = 400  # of the measurements, 4 s

RAYLEIGH = {"type": "RayleighDamping", "alpha": "zeta", "beta": 1e-4}
MODAL = {"type": "ModalDamping", "ratios": ["zeta", 0.02, 0.01]}
MATRIX = [[800.0, -400.0, 0.0], [-400.0, 800.0, -400.0], [0.0, -400.0, 400.0]]
CHAIN = {"mass": 0.15, "stiffness": ["k1", "k2", "k3"], "damping": MODAL}
TERMS = {"stiffness_terms": [MATRIX, {}], "theta": ["k1", {"prior": "k2", "times": 2.0}]}
LINEAR = {"mass": [0.1] * 3, "stiffness": MATRIX, "damping": RAYLEIGH}
BOUC_WEN = {"yield_displacement": 0.01, "post_yield_ratio": 0.1}
TAPER = {"base": "k1", "top": "k2", "exponent": 1.5, "times": [1.0, 1.1, 1.2]}
GROUPS = {"n": 3, "mass": {"groups": [[0.16, 2], [0.14, 1]]}, "stiffness": TAPER, "damping": MODAL}
OF_MODES = {
    **{"file": "modes.csv", "channels": {"floor1": 0, "roof": 2}, "modes": [1, 2], "nodes": "nodes.csv"},
    **{"sigma_f": "sigma", "sigma_phi": 0.05, "density": "TN", "scale": {"roof": -1.0}},
}
SETUPS = {
    **{"files": ["modes.csv", "setup.csv"], "references": ["roof"], "names": {"frequency": "frequency"}},
    **{"channels": {"floor1": 0, "floor2": 1, "roof": 2}, "sigma_f": 0.01, "sigma_phi": 0.1},
}
BARE = {"quantities": None, "natural_frequencies": None}
# what identified modes alone do without
ALONE = {"data": None, "likelihood": None, "processing": None, "report": BARE}
WIND = {"data": {"base": None, "excitation": "ambient"}, "likelihood": None, "report": BARE}
VARIANTS = [  # sections, and what is different there
    {"likelihood": {"kinds": ["TN"]}, "sampler": {"method": "smc", "kernel": "TMCMC", "cores": 2}},
    {
        "structure": {**CHAIN, **BOUC_WEN, "type": "HystereticChain"},
        "processing": {"band_pass": {"low": 0.5, "high": 25.0, "order": 4}},
    },
    {"structure": {**LINEAR, "type": "LinearStructure"}, "sampler": {"method": "nuts", "tune": 500}},
    {
        "structure": {**LINEAR, "type": "AffineStructure", **TERMS},
        "likelihood": {"kinds": ["CN-TAU"], "sigma": ["sigma", 0.1, 0.3], "correlation_time": "sigma"},
    },
    {
        "structure": {**CHAIN, "type": "SpringMassChain", "n_modes": 2},
        "data": {"sensors": ["floor2"], "dofs": [1], "columns": {"base": 1, "floor2": 3}, "dt": 0.01}
        | {"scale": {"floor2": -1.0}, "delay": {"floor2": 0.0125}, "rows": [10, 390]},
        "processing": {
            "trim": [0.0, 3.0],
            "decimate": 2,
            "detrend": {"window": [0.0, 0.5]},
            "check_band": False,
        },
        "likelihood": {"kinds": ["GAMMA", "ABC"], "sigma": "sigma", "m": 3.0, "epsilon": 5.0},
    },
    {
        "structure": {"type": "SpringMassChain", **GROUPS},
        "record": {"path": "motion.csv", "units": "g", "dt": 0.01, "column": 0},
        "data": {"base": None},
    },
    {"likelihood": {"kinds": ["CAL", "EXP"]}, "modal": {**OF_MODES, "labels": ["first", "second"]}},
    {**ALONE, "modal": SETUPS},
    {
        "events": {"folder": ".", "pattern": "measured*.csv", "drift": {"k1": 5.0}, "change": 0.01},
        "data": {"files": None},
        "likelihood": {"kinds": ["NORM", "EXP"]},
    },
    {
        **WIND,
        "processing": {"band_pass": None, "trim": [0.5, 3.5], "check_band": None},
        "ambient": {"bands": [[2.0, 6.0], [7.0, 20.0]], "force": ["sigma", 2.0], "error": [1e-3, 0.1]},
    },
]
MODES = "frequency,floor1,roof\n3.7,0.5,1.0\n10.4,-1.0,0.6\n"
SETUP = "frequency,floor2,roof\n3.71,0.8,1.0\n10.5,-0.6,0.6\n"
NODES = "dof,z,line\n,0,1\n0,1,1\n1,2,1\n2,3,1\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("mutated")


def originals(folder):
    """Configurations that are read, as tables."""
    path = write_example(folder / "original.toml", synthetic=True)[0][0]
    lines = (folder / "original-measured.csv").read_text().splitlines()[: ROWS + 1]
    (folder / "measured.csv").write_text("\n".join(lines) + "\n")
    shutil.copy(folder / "measured.csv", folder / "measured-2.csv")
    (folder / "motion.csv").write_text("\n".join(["acceleration", *["0.1", "-0.1"] * (ROWS // 2)]) + "\n")
    for name, text in (("modes", MODES), ("setup", SETUP), ("nodes", NODES)):
        (folder / f"{name}.csv").write_text(text)
    example = tomllib.loads(path.read_text())
    example["data"]["files"] = "measured.csv"
    for changes in VARIANTS:
        table = copy.deepcopy(example)
        for name, section in changes.items():
            if section is None:
                del table[name]
                continue
            kept = {} if name == "structure" else table.get(name, {})
            merged = copy.deepcopy(kept | section)
            table[name] = {key: value for key, value in merged.items() if value is not None}
        if table["structure"].get("type") in ("LinearStructure", "AffineStructure"):
            table["report"]["quantities"] = []
        yield without_idle_priors(table)


def without_idle_priors(table):
    """Those that structure and likelihoods name."""
    named = str([table.get(name) for name in ("structure", "likelihood", "modal", "ambient")])
    table["priors"] = {name: prior for name, prior in table["priors"].items() if f"'{name}'" in named}
    return table


def stands(path):
    """All that happens before something is sampled, and the data of the report."""
    problem = read_problem(path)
    problem.settings()
    for event in getattr(problem.first, "events", {}).values():
        assert declare(problem.first.at(problem, event), problem.kinds[0]).free_RVs
    for kind in problem.kinds:
        tolerance = (problem.config.likelihood.epsilon or 1.0) if kind == "ABC" else None
        model = declare(problem, kind, tolerance)
        assert model.free_RVs
        sampling.method_of(problem, kind), sampling.seed_of(problem, kind)
    for data in problem.data:
        if data.key != "ambient":  # modes of which are identified, in seconds
            data.shared(problem)


def outcome(path) -> str:
    """What is said about a file, empty if nothing: never anything but a sentence on the file, and at once.

    A slow one is read once more: pauses in which garbage of other tests is collected are none of the file.
    """
    for _ in range(2):
        start, said = time.thread_time(), ""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                stands(path)
            except ConfigError as error:
                said = str(error)
                assert re.search(r"`[^`]+`|\[[a-z_.]+\]|mutated.toml", said), f"what is wrong? {said}"
                assert len(said) < 1500, said[:1500]
        if (seconds := time.thread_time() - start) < SECONDS:
            return said
    raise AssertionError(f"{seconds} s")


def mutate(folder, seed, count):
    """What is said about each of many damaged configurations."""
    rng, tables = np.random.default_rng(seed), list(originals(folder))
    path = folder / "mutated.toml"
    for table in tables:
        path.write_text(as_toml(table))
        stands(path)
    before, said = peak(), []
    for _ in range(count):
        path.write_bytes(mutated_config(pick(tables, rng), rng))
        said.append(outcome(path))
    assert peak() - before < MEMORY
    return said


@pytest.mark.slow
def test_damaged_configurations(folder):
    said = mutate(folder, 11, MUTATIONS)
    refused = sum(map(bool, said))
    assert MUTATIONS // 2 < refused < MUTATIONS


def test_a_structure_without_a_natural_frequency(tmp_path):
    """A mass so small that its inverse is no number."""
    [table] = [t for t in originals(tmp_path) if t["structure"]["type"] == "LinearStructure"]
    table["structure"]["mass"] = [0.1, 0.1, 1e-308]
    (tmp_path / "mutated.toml").write_text(as_toml(table))
    with pytest.raises(ConfigError, match=r"\[structure\]: masses and stiffnesses must have a natural freq"):
        read_problem(tmp_path / "mutated.toml")
