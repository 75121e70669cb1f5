"""Types of the public surface, as a type checker shows them: no name without one, wrong calls found."""

import os
import re
import subprocess
import sys

import pytest

import pymc_features as pmf
import pymc_features.update
from support.commands import ROOT

SETTINGS = """[mypy]
follow_imports = silent
ignore_missing_imports = True
[mypy-pymc.*,pytensor.*,arviz.*,scipy.*,pandas.*,matplotlib.*,plotly.*,numba.*,llvmlite.*,h5py.*,jinja2.*]
follow_imports = skip
[mypy-rich.*,pydantic.*,jax.*,distributed.*,dask.*]
follow_imports = skip
"""
USE = """import numpy as np
import pymc_features as pmf
from pymc_features import update

record = pmf.synthetic_earthquake(10.0, 0.02, random_seed=1, pga=3.0)
chain = pmf.SpringMassChain(mass=np.ones(10), stiffness=1800.0, damping=pmf.ModalDamping(0.02))
measured = pmf.simulate(chain.scale_stiffness(0.9, springs=[0, 1, 2]), record, sensors=[9])
model = pmf.response(chain, record, sensors=[9], quantity="absolute_acceleration")
likelihood = pmf.ExpFeature("y", mu=model, sigma=0.1, observed=measured.values)
idata = pmf.sample(1000, chains=2, random_seed=1, check=None)
shapes = pmf.modal.mac(np.eye(3), np.eye(3))
channels = pmf.signals.band_pass(pmf.read_channels("floors.csv", units="g"), low=0.2, high=40.0)
problem = update.read_problem("update.toml")
update.write_outputs(problem, update.run_update(problem, out="here"), "here")
"""
#: Wrong calls, each to a part of what is said of it.
WRONG = {
    'pmf.sample("many")': "incompatible type",
    "pmf.simulate(chain)": "Missing positional argument",
    "pmf.simulate(chain, record, sensor=[9])": 'Unexpected keyword argument "sensor"',
    "pmf.Record([1.0], dt='slow')": "incompatible type",
    "chain.scale_stifness(0.9, springs=[0])": "has no attribute",
    "pmf.signals.trim(measured, 1.0)": "Missing positional argument",
    "pmf.ModalFeature('f', sigma=0.1)": 'did you mean "sigma_f"',
    "update.run_update(problem, 'here')": "Too many positional arguments",
}


def public_names():
    """Every public name with its place, submodules looked through."""
    for name in pmf.__all__:
        found = getattr(pmf, name)
        inner = getattr(found, "__all__", None)
        yield from (f"pmf.{name}.{one}" for one in inner) if inner else [f"pmf.{name}"]
    yield from (f"update.{name}" for name in pmf.update.__all__)


@pytest.mark.slow
def test_public_names_have_types_and_wrong_calls_are_found(tmp_path):
    (tmp_path / "mypy.ini").write_text(SETTINGS)
    wrong, names = list(WRONG), list(public_names())
    lines = [*USE.splitlines(), *wrong, *(f"reveal_type({name})" for name in names)]
    (tmp_path / "use.py").write_text("\n".join(lines) + "\n")
    settings = ("--config-file", "mypy.ini", "--cache-dir", "cache", "--no-error-summary")
    command = sys.executable, "-m", "mypy", *settings, "use.py"
    given = {"cwd": tmp_path, "env": os.environ | {"MYPYPATH": str(ROOT)}}
    told = subprocess.run(command, capture_output=True, text=True, **given).stdout
    of_line: dict[int, str] = {}
    for number, text in re.findall(r"^use\.py:(\d+): (?:error|note): (.*)$", told, re.MULTILINE):
        of_line[int(number)] = of_line.get(int(number), "") + text
    first = len(USE.splitlines())
    assert {number: text for number, text in of_line.items() if number <= first} == {}
    found = {call: of_line.get(first + 1 + k, "") for k, call in enumerate(wrong)}
    assert {call: text for call, text in found.items() if WRONG[call] not in text} == {}
    first += len(wrong)
    untyped = [name for k, name in enumerate(names) if 'type is "Any"' in of_line.get(first + 1 + k, '"Any"')]
    assert untyped == []
    assert len(names) > 100
