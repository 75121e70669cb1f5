"""Who may import whom, what is public, and which members each catalogue has."""

import ast
import functools
import inspect
import sys
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest

import pymc_features
from support.commands import run

ROOT = Path(pymc_features.__file__).parent

GROUND = {"_checks", "exceptions", "lazy"}  # every unit may import these, and they import nothing of ours

# package -> what of ours it may import, besides itself and the ground
ALLOWED = {
    "_checks": set(),
    "exceptions": set(),
    "lazy": set(),
    "band_limited": set(),
    "records": {"signals", "band_limited"},
    "algebra": set(),
    "structures": {"algebra", "records", "simulators", "io"},  # of these the modes of chains
    "simulators": {"algebra", "records", "band_limited"},
    "signals": set(),
    "modal": {"records", "structures", "simulators", "ops", "io"},
    "io": {"records", "signals", "band_limited"},
    "datasets": {"records", "io", "modal"},
    "ground_motion": {"records"},
    "external": {"ops", "fingerprint", "inference", "smc", "progress", "system"},
    "storage": set(),
    "system": set(),
    "fingerprint": set(),
    "prediction": {"records", "structures", "simulators", "inference", "smc", "calibration"},
    "ops": {"algebra", "records", "structures", "simulators", "band_limited"},
    "ambient": {"records", "structures", "simulators", "ops", "modal", "signals"},
    "likelihoods": {"ops", "modal", "fingerprint"},
    "smc": {"external", "simulators", "system"},  # of it the workers, as in the next
    "inference": {"records", "structures", "simulators", "ops", "likelihoods", "external", "smc"},
    "sampling": {"inference", "smc"},
    "calibration": {"ops", "likelihoods", "inference", "smc"},
    "events": {"inference", "smc", "calibration", "storage"},
    "study": {
        *("records", "structures", "simulators", "io", "datasets", "ground_motion"),
        *("ops", "likelihoods", "smc", "inference", "calibration", "storage"),
        "plots",
    },
    "plots": {"records", "likelihoods", "modal", "signals"},
    "progress": set(),
    "update": {
        *("records", "structures", "signals", "io", "datasets", "ground_motion", "simulators", "ops"),
        *("likelihoods", "smc", "inference", "calibration", "prediction"),
        *("storage", "plots", "modal", "events", "ambient"),
        "external",
    },
}
ANYTHING = {"__init__", "__main__", "public", "cli", "warm_up"}

PUBLIC_NAMES = [
    "AffineStructure",
    "AmbientResponse",
    "CorrelatedNormal",
    "DiscrepancySimulator",
    "DuffingChain",
    "ExpFeature",
    "ExternalSimulator",
    "FrequencyResponse",
    "GammaFeature",
    "HystereticChain",
    "LinearStructure",
    "Loading",
    "ModalDamping",
    "ModalFeature",
    "PersistentSMC",
    "ProgramSimulator",
    "RayleighDamping",
    "Record",
    "SpringMassChain",
    "SubsetSimulation",
    "TMCMC",
    "TruncNormalFeature",
    "calibrate",
    "compare",
    "compiled_logp",
    "effective_samples",
    "emulate",
    "event_check",
    "fisher_information",
    "hierarchical",
    "identify_modes",
    "laplace",
    "mean_square_discrepancy",
    "modes",
    "read_channels",
    "read_matrices",
    "read_modal",
    "read_record",
    "response",
    "sample",
    "sample_nuts",
    "sample_smc",
    "sensor_placement",
    "simulate",
    "synthetic_earthquake",
]
SUBMODULES = [
    "ambient",
    "calibration",
    "datasets",
    "events",
    "exceptions",
    "external",
    "io",
    "likelihoods",
    "modal",
    "paper",
    "plots",
    "prediction",
    "sampling",
    "signals",
    "structures",
    "study",
]


class Facts(NamedTuple):
    """What a file imports, its classes, its grouped arguments, and its functions with their parameters."""

    imports: set[str]
    classes: set[str]
    grouped: list[int]
    functions: dict[str, list[str]]


@functools.cache
def facts_of(path: Path) -> Facts:
    """At any depth of its code; imports for annotations alone do not count."""
    return facts_in(path.read_text(), path)


def facts_in(source: str, path="<text>") -> Facts:
    """Facts of a source; `*(a, b), *(c, d)` are tuples that are written only to be unpacked."""
    found, annotations = Facts(set(), set(), [], {}), set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            annotations |= {*node.body}
        elif isinstance(node, ast.Import) and node not in annotations:
            found.imports.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node not in annotations:
            assert node.level == 0, f"{path}: relative import"
            ours = node.module == "pymc_features"
            names = {f"pymc_features.{alias.name}" for alias in node.names} if ours else {node.module}
            found.imports.update(names)
        elif isinstance(node, ast.ClassDef):
            found.classes.add(node.name)
        elif isinstance(node, ast.Starred) and isinstance(node.value, ast.Tuple):
            found.grouped.append(node.lineno)
        elif isinstance(node, ast.FunctionDef):
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            found.functions[f"{node.name}, line {node.lineno}"] = names
    return found


def imports_of(path: Path) -> set[str]:
    """Names of modules that a file imports."""
    return facts_of(path).imports


def unit_of(path: Path) -> str:
    """Folder, or module, directly below the package."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def violations(path: Path, unit: str) -> list[str]:
    """What a file of `unit` imports and must not."""
    wrong = []
    for module in imports_of(path):
        parts = module.split(".")
        ours = parts[0] == "pymc_features" and len(parts) > 1 and unit not in ANYTHING
        if ours and parts[1] not in {unit, *GROUND, *ALLOWED[unit]}:
            wrong.append(module)
        if parts[1:2] == ["external"] and unit in ("smc", "inference") and parts[2:3] != ["workers"]:
            wrong.append(module)
        if parts[0] == "matplotlib" and unit != "plots":
            wrong.append(module)
        if parts[0] == "jax" and path.name != "jax_dispatch.py":
            wrong.append(module)
        if parts[0] in ("pymc", "pytensor") and unit in ("algebra", "simulators", "records", "signals", "io"):
            wrong.append(module)
    return wrong


def test_import_rule():
    for path in sorted(ROOT.rglob("*.py")):
        assert unit_of(path) in set(ALLOWED) | ANYTHING, "a new unit needs a line in ALLOWED"
        assert violations(path, unit_of(path)) == [], path


def test_import_rule_can_fail(tmp_path):
    bad = tmp_path / "bad.py"
    bad.write_text("import pymc\nfrom pymc_features.ops import response\nfrom pymc_features import study\n")
    assert set(violations(bad, "simulators")) == {"pymc", "pymc_features.ops", "pymc_features.study"}


# rooms of simulators/ -> which others they may import; the files above them may import all
SIMULATOR_ROOMS = {
    "compiled": set(),
    "numbers": {"compiled"},
    "oscillators": {"compiled", "numbers"},
    "eigen": {"compiled", "numbers", "oscillators"},
    "long_records": {"compiled", "numbers", "oscillators"},
    "chain": {"compiled", "numbers", "oscillators", "eigen", "long_records"},
    "linear": {"compiled", "numbers", "oscillators", "eigen", "long_records"},
    "taylor": {"compiled", "numbers", "oscillators"},
    "nonlinear": {"compiled", "numbers", "oscillators", "chain", "taylor"},
    "modal": {"compiled", "oscillators", "chain", "linear"},
}


def room_of(path: Path) -> str:
    """Folder of a file; a file beside the rooms is a room of its own."""
    return str(path.parent.relative_to(ROOT)) if path.parent != ROOT else path.stem


def test_rooms_of_the_simulators():
    for room, allowed in SIMULATOR_ROOMS.items():
        for path in (ROOT / "simulators" / room).glob("*.py"):
            parts = [module.split(".")[1:] for module in imports_of(path)]
            used = {part[1] for part in parts if len(part) > 1 and part[0] == "simulators"}
            assert used <= {room.split("/")[0], *allowed}, f"{path.name} imports {used - {room, *allowed}}"


def mutual_imports(files: dict[Path, set[str]]) -> set[frozenset[str]]:
    """Pairs of rooms that import each other, from the modules that each file imports."""
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in files}
    edges = set()
    for path, imported in files.items():
        ours = (name for name in imported if name.startswith("pymc_features."))
        names = {name.removeprefix("pymc_features.").removesuffix(".__init__") for name in ours}
        targets = {modules.get(name) or modules.get(f"{name}.__init__") for name in names} - {None}
        edges |= {(room_of(path), room_of(target)) for target in targets}
    return {frozenset((a, b)) for a, b in edges if a != b and (b, a) in edges}


def test_no_two_rooms_import_each_other():
    files = {path: imports_of(path) for path in ROOT.rglob("*.py") if path != ROOT / "public.py"}
    assert mutual_imports(files) == set()
    files[ROOT / "smc" / "kernels" / "imh.py"] = {"pymc_features.smc.sample"}
    assert mutual_imports(files) == {frozenset(("smc", "smc/kernels"))}  # as `sample` imports a kernel


def test_folders_stay_small():
    counts = {folder: len(list(folder.glob("*.py"))) for folder in ROOT.rglob("*") if folder.is_dir()}
    assert {folder.name: n for folder, n in counts.items() if n > 16} == {}


def test_public_names():
    """The contract: names stay. Adding one means adding it here."""
    assert pymc_features.__all__ == PUBLIC_NAMES + SUBMODULES and len(PUBLIC_NAMES) <= 45
    for name in set(SUBMODULES) - {"paper"}:  # what is in them without being theirs is not shown
        module = getattr(pymc_features, name)
        assert dir(module) == sorted(module.__all__), name
    for name in pymc_features.__all__:
        assert getattr(pymc_features, name).__doc__, f"{name} has no docstring"
    for name in ("nothing", "plot_nothing"):
        with pytest.raises(AttributeError, match=f"has no attribute '{name}'"):
            getattr(pymc_features, name)
    for name, place in {"mac": "modal.mac", "plot_mac": "plots.mac"}.items():
        with pytest.warns(FutureWarning, match=f"`pymc_features.{name}` is `pymc_features.{place}`"):
            assert getattr(pymc_features, name) is attrgetter(place)(pymc_features)


def test_exceptions_live_in_one_module():
    """All that is raised or warned of by a name of ours, and nothing else of it anywhere."""
    for path in ROOT.rglob("*.py"):
        named = {name for name in facts_of(path).classes if name.endswith(("Error", "Warning"))}
        assert named == (set(pymc_features.exceptions.__all__) if path.name == "exceptions.py" else set())


def test_the_command_imports_little_before_it_answers_to_ctrl_c():
    """And so does the package, before a name of it is asked for."""
    slow = ["numpy", "rich", "argparse", "multiprocessing", "pymc_features.public", "pymc"]
    code = f"import sys, pymc_features.cli as cli; print([m for m in {slow} if m in sys.modules])"
    assert run(sys.executable, "-c", code).strip() == "[]"


@pytest.mark.processes
def test_names_are_imported_when_they_are_asked_for():
    code = """if True:
        import sys, pymc_features as pmf
        assert "pymc" not in sys.modules
        for name in ("__wrapped__", "__test__"):
            assert not hasattr(pmf, name) and "pymc" not in sys.modules
        from pymc_features import records
        assert "pymc" not in sys.modules
        assert pmf.Record is records.Record and pmf.read_record and pmf.read_modal
        assert not {"pymc", "pytensor", "arviz", "pandas", "xarray"} & {*sys.modules}
        assert pmf.response and "pymc" in sys.modules
        assert not {"jax", "matplotlib", "scipy.signal", "arviz"} & {*sys.modules}
        assert pmf.io.__name__ == "pymc_features.io"
        assert set(dir(pmf)) >= {*pmf.__all__, "records"}
        from pymc_features import *
        assert sample is pmf.inference.sample
        import pymc
        with pymc.Model():
            pymc.Normal("y", pymc.Normal("x"), 1.0, observed=1.0)
            sample_smc(20, chains=1, cores=1, progressbar=False)
        assert "jax._src" not in sys.modules  # as SciPy's logsumexp would wake it, for seconds
    """
    run(sys.executable, "-c", code)


def test_files_stay_small():
    for path in ROOT.rglob("*.py"):
        assert path.read_text().count("\n") <= 600, f"{path.name}: is there a second concept inside?"


def test_arguments_are_not_grouped():
    """A call may be long; its arguments are not bundled to make it look shorter."""
    found = {str(path.relative_to(ROOT)): facts_of(path).grouped for path in ROOT.rglob("*.py")}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_grouped_arguments_are_found():
    source = "f(\n    *(a, b),\n    *c,\n    *(x for x in d),\n)"
    assert facts_in(source).grouped == [2]


@pytest.mark.parametrize("arguments", [["check"], ["format", "--check"]], ids=" ".join)
def test_style(arguments):
    run(sys.executable, "-m", "ruff", *arguments, "--no-cache", str(ROOT.parent))


FEW = 10


def test_functions_have_few_parameters():
    for path in ROOT.rglob("*.py"):
        for function, names in facts_of(path).functions.items():
            count = len(names) - (names[:1] in (["self"], ["cls"]))
            assert count <= FEW, f"{path.name}: {function} has {count} parameters"


def public_functions(place: str, value) -> Iterator[tuple[str, Callable]]:
    """A public function by its name; those of a module, and the methods of a class and its bases of ours."""
    if isinstance(value, ModuleType):
        for name in getattr(value, "__all__", [n for n in vars(value) if not n.startswith("_")]):
            member = getattr(value, name)
            if getattr(member, "__module__", "").startswith(value.__name__):
                yield from public_functions(f"{place}.{name}", member)
    elif inspect.isclass(value):
        for base in value.__mro__:
            if base.__module__.startswith("pymc_features"):
                for name, member in vars(base).items():
                    if name in ("__init__", "__new__", "__call__") or not name.startswith("_"):
                        member = getattr(member, "__func__", getattr(member, "fget", member))
                        if inspect.isfunction(member) and member.__module__.startswith("pymc_features"):
                            yield f"{base.__name__}.{name}", member
    elif inspect.isfunction(value):
        yield place, value


def test_public_functions_are_annotated():
    """Every parameter of every public function and method, and what it returns."""
    checked, silent = set(), []
    for name in pymc_features.__all__:
        for place, function in public_functions(name, getattr(pymc_features, name)):
            signature = inspect.signature(function)
            for parameter in signature.parameters.values():
                allowed = parameter.name in ("self", "cls") or parameter.kind is parameter.VAR_KEYWORD
                if parameter.annotation is parameter.empty and not allowed:
                    silent.append(f"{place}: {parameter.name}")
            if signature.return_annotation is signature.empty and not place.endswith("__init__"):
                silent.append(f"{place}: what it returns")
            checked.add(place)
    assert silent == []
    assert {
        "response",
        "paper.chain",
        "signals.trim",
        "PopulationKernel.set_rng",
        "Record.resampled",
    } <= checked
    assert (ROOT / "py.typed").exists()
