"""Cost of one evaluation against degrees of freedom, for each family of structures.

Populations through the kernels that the Ops call: ns per particle and step of the record. The same shear
building is a chain, a dense LinearStructure, one with a dashpot that couples its modes, and a chain with
nonlinear springs; beside them what people write with SciPy, JAX and OpenSees, where they are installed. Large
sparse frames keep 20 modes: ms for one value and for one gradient, of the same structure again and again, and
of one of a population in a common basis, with and without building it.
"""

import numpy as np
from scipy import sparse

import pymc_features as pmf
from benchmarks.case import ALPHA, BETA, build, record_of_length
from benchmarks.peers import PEERS
from benchmarks.peers.population import Population
from benchmarks.routes import filters
from benchmarks.tables import significant, table
from benchmarks.timing import best_of_rounds, fitted_exponent
from pymc_features.simulators import FAMILIES
from pymc_features.simulators.linear.known import KNOWN
from pymc_features.simulators.oscillators.arguments import NO_DIRECT

SIZES = (3, 10, 30, 100)
GRIDS = ((10, 30), (20, 50), (20, 100))  # bays and storeys of the sparse frames
N_MODES = 20


def structures(case):
    """The same building by name: a structure of the nominal stiffness."""
    n, damping = case.n_dof, pmf.RayleighDamping(ALPHA, BETA)
    mass, stiffness = case.mass, np.full(n, case.stiffness.mean())
    chain = pmf.SpringMassChain(mass, stiffness, damping)
    m, c, k = chain.matrices()
    dashpot = np.zeros((n, n))
    dashpot[-1, -1] = 2.0
    terms = [np.diag(np.eye(n)[0] * stiffness[0])]
    yields = {"yield_displacement": 0.05, "post_yield_ratio": 0.1}
    return {
        "chain": chain,
        "LinearStructure": pmf.AffineStructure(m, stiffness=k, damping=damping, stiffness_terms=terms),
        "coupled damping": pmf.AffineStructure(m, stiffness=k, damping=c + dashpot, stiffness_terms=terms),
        "HystereticChain": pmf.HystereticChain(mass, stiffness, damping, **yields),
        "DuffingChain": pmf.DuffingChain(mass, stiffness, damping, cubic=1e4),
    }


def population(structure, case):
    """As many particles as the case has, whose springs differ by 10 %."""
    rng = np.random.default_rng(0)
    parameters = [np.array(p)[None] for p in structure.parameters()]
    varied = 0 if structure.family == "linear" else 1  # theta, or the springs
    spread = 0.1 * rng.uniform(-1.0, 1.0, (len(case.stiffness), parameters[varied].shape[1]))
    parameters[varied] = parameters[varied] * (1.0 + spread) + (spread if varied == 0 else 0.0)
    return Population(structure, tuple(parameters), case)


def kernels(population):
    """Calls of our kernels for e_j (P, s) and for the gradient of their sum."""
    structure, parameters, case = population
    family, record = FAMILIES[structure.family], pmf.Record(case.acceleration, case.dt)
    rows = family.rows(case.sensors, case.n_dof)
    rows = rows.toarray() if sparse.issparse(rows) else rows
    excitation = (np.array(structure.excitation(record)), case.dt, case.substeps, 1, NO_DIRECT)
    inputs = (*parameters, *structure.constants(record), *excitation, rows, case.n_dof)
    arguments = family.assemble(inputs, 0)
    weights = np.ones((len(case.stiffness), case.sensors.size, 1))
    return {
        "value": lambda: family.kernels["population_discrepancy"](*arguments, case.observed),
        "gradient": lambda: family.kernels["population_gradient"](*arguments, case.observed, weights),
    }


def with_peers(name, given):
    """Our call and those of tools that know the structure; how far they are off ours; what is missing."""
    calls = {name: kernels(given)["value"]}
    expected, differences, missing = calls[name](), {}, set()
    for peer, (prepare, known, count) in PEERS.items():
        if name not in known:
            continue
        label = f"{name}: {peer}"
        try:
            calls[label] = prepare(given.first(count))
        except ImportError as error:
            missing.add(error.name)
            continue
        found = calls[label]()
        differences[label] = np.abs(found / expected[: len(found)] - 1.0).max()
    return calls, differences, missing


def run_families(rounds, sizes):
    """Print the cost of families of structures, and of other tools, against degrees of freedom."""
    seconds, differences, missing = {}, {}, set()
    for size in sizes:
        case = build(record_of_length(1000), particles=128, n_dof=size, n_sensors=min(5, size))
        for name, structure in structures(case).items():
            calls, found, absent = with_peers(name, population(structure, case))
            missing |= absent
            if name == "chain":
                calls["chain: SciPy eigh, lfilter"] = filters.prepare(case.first(20))
            for label, best in best_of_rounds(calls, min(rounds, 3)).items():
                peer = PEERS.get(label.partition(": ")[2])
                count = peer.particles if peer else 20 if label.endswith("lfilter") else 128
                seconds.setdefault(label, []).append(1e9 * best / case.first(count).steps)
            differences |= found  # those of the largest
    rows = [
        [
            name,
            *map(significant, found),
            f"{fitted_exponent(sizes, found):.2f}",
            *map(significant, [found[-1] / seconds[name.partition(":")[0]][-1]]),
            f"{differences[name]:.0e}" if name in differences else "",
        ]
        for name, found in seconds.items()
    ]
    print("\n## Families of structures: ns per particle and step, 1000 samples, 5 sensors, all modes\n")
    last = f"{sizes[-1]} DOF"
    headers = [*(f"{size} DOF" for size in sizes), "exponent", f"x ours, {last}", f"e_j differ by, {last}"]
    print(table(["structure", *headers], rows), flush=True)
    if missing:
        print(f"\nNot installed: {', '.join(sorted(missing))}.")


def run_exponents(rounds, quick):
    """Print how the cost of a particle grows with samples and with parameters, ten degrees of freedom."""
    studies = {"samples": (1_000, 2_000, 4_000, 8_000), "parameters": (1, 3, 10)}
    for study, sizes in studies.items():
        sizes, costs = sizes[: 2 if quick else None], {}
        for size in sizes:
            case = build(
                record_of_length(size if study == "samples" else 1000), particles=64, n_dof=10, n_sensors=5
            )
            chosen = structures(case)
            if study == "parameters":
                chosen = {
                    name: with_terms(chosen[name], size) for name in ("LinearStructure", "coupled damping")
                }
            for name, structure in chosen.items():
                best = best_of_rounds(kernels(population(structure, case)), rounds)
                for what, own in best.items():
                    costs.setdefault(f"{name}, {what}", []).append(1e6 * own / 64)
        rows = [
            [name, *map(significant, own), f"{fitted_exponent(sizes, own):.2f}"]
            for name, own in costs.items()
        ]
        print(f"\n## Cost of a particle against {study}: us, 10 DOF, 5 sensors\n")
        print(table(["structure", *(f"{size:,}" for size in sizes), "exponent"], rows), flush=True)


def with_terms(structure, count):
    """The same structure with a factor for each of its lowest springs."""
    k = structure.stiffness
    terms = [np.zeros_like(k) for _ in range(count)]
    for i, term in enumerate(terms):
        above = -k[i, i - 1] if i else k[0, 0] + k[0, 1]
        ends = [i - 1, i] if i else [0]
        term[np.ix_(ends, ends)] = above * (np.array([[1.0, -1.0], [-1.0, 1.0]]) if i else 1.0)
    return pmf.AffineStructure(structure.mass, stiffness=k, damping=structure.damping, stiffness_terms=terms)


def frame(bays, storeys):
    """A sparse plane grid of springs on a fixed base, the lower and the upper half with a factor each."""
    place = np.arange(bays * storeys).reshape(storeys, bays)
    across = np.stack([place[:, :-1].ravel(), place[:, 1:].ravel()], axis=1)
    up = np.stack([place[:-1].ravel(), place[1:].ravel()], axis=1)
    pairs = np.concatenate([across, up])
    n, count = place.size, np.arange(len(pairs))
    values = np.concatenate([np.ones(count.size), -np.ones(count.size)])
    drifts = sparse.csr_array((values, (np.tile(count, 2), pairs.T.ravel())), shape=(count.size, n))
    lower = pairs.max(axis=1) < n // 2
    halves = [1e5 * sparse.csc_array(d.T @ d) for d in (drifts[lower], drifts[~lower])]
    base = sparse.diags_array(np.where(np.arange(n) < bays, 1e5, 0.0))
    damping = pmf.ModalDamping(np.full(N_MODES, 0.02))
    return pmf.AffineStructure(
        np.ones(n),
        stiffness=sparse.csc_array(base),
        damping=damping,
        stiffness_terms=halves,
        theta=[1.0, 1.0],
    )


def value_and_gradient(structure, record):
    """Calls for e_j of one particle and for its gradient, with four sensors up the height."""
    family, n = FAMILIES["linear"], structure.n_dof
    sensors = np.linspace(n // 4, n - 1, 4).astype(int)
    rows = family.rows(sensors, n).toarray()
    _, *rest = *structure.parameters(), *structure.constants(record)
    excitation = (structure.excitation(record), record.dt, 1, 1, NO_DIRECT)

    def arguments(theta):
        return family.assemble((np.array(theta), *rest, *excitation, rows, N_MODES), 0)

    data = family.kernels["response"](*arguments([1.1, 0.9]))
    inputs, weights = (*arguments([1.0, 1.0]), data), np.ones((sensors.size, 1))
    return {
        "value": lambda: family.kernels["discrepancy"](*inputs),
        "gradient": lambda: family.kernels["misfit_gradient"](*inputs, weights),
    }


def population_in_a_basis(structure, record, particles):
    """Calls for value and gradient of a population within 20 %, without a basis and with the last one."""
    family, n = FAMILIES["linear"], structure.n_dof
    rows = family.rows(np.linspace(n // 4, n - 1, 4).astype(int), n).toarray()
    theta, *rest = structure.parameters()
    spread = np.random.default_rng(0).uniform(-0.2, 0.2, (particles, theta.size))
    parameters = theta * (1.0 + spread), *(x[None] for x in rest)
    excitation = (structure.excitation(record), record.dt, 1, 1, NO_DIRECT)
    inputs = (*parameters, *structure.constants(record), *excitation, rows, N_MODES)
    arguments, data = family.assemble(inputs, 0), np.zeros((4, record.acceleration.size))
    weights, kernels = np.ones((particles, 4, 1)), family.kernels

    def anew(call):
        def run_anew():
            KNOWN.forget()
            call()

        return run_anew

    def value():
        kernels["population_discrepancy"](*arguments, data)

    def gradient():
        kernels["population_gradient"](*arguments, data, weights)

    return {
        "value, anew": anew(value),
        "value": value,
        "gradient, anew": anew(gradient),
        "gradient": gradient,
    }


def run(quick=False):
    """Print all tables."""
    rounds = 2 if quick else 7
    run_families(rounds, SIZES[: 2 if quick else None])
    run_exponents(rounds, quick)
    record, rows = record_of_length(1559), []
    for bays, storeys in GRIDS[: 1 if quick else None]:
        best = best_of_rounds(value_and_gradient(frame(bays, storeys), record), rounds)
        ratio = best["gradient"] / best["value"]
        rows.append(
            [f"{bays * storeys:,}", *map(significant, (1e3 * s for s in best.values())), f"{ratio:.1f}"]
        )
    print(f"\n## Sparse frames, {N_MODES} modes, 4 sensors, 1559 samples\n")
    print(table(["DOF", "value: ms", "gradient: ms", "x value"], rows), flush=True)
    rows, particles = [], 16 if quick else 500
    for bays, storeys in GRIDS[: 1 if quick else None]:
        calls = population_in_a_basis(frame(bays, storeys), record, particles)
        best = best_of_rounds(calls, 1 if quick else 2)
        rows.append([f"{bays * storeys:,}", *(significant(1e3 * s / particles) for s in best.values())])
    print(f"\n## The same, each of {particles} in a common basis: ms\n")
    print(table(["DOF", *best], rows), flush=True)
