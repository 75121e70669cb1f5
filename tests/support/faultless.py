"""Buildings and records without a fault, by a simulator that shares nothing with the package."""

import numpy as np

from benchmarks import truth

STOREY = 1e5, 1.5e8  # kg, N/m
SENSORS = 3


def faultless(folder, seed: int):
    """A configuration and its channels, written into a folder; its truth is a draw of its priors.

    A chain of two to eight storeys in up to three groups of unknown stiffness, one to three sensors besides
    the base, 50 to 200 Hz, 20 to 60 s, 1 to 10 % of noise at the floors.
    """
    rng = np.random.default_rng([7, seed])
    n = int(rng.integers(2, 9))
    mass, drawn = STOREY[0] * rng.uniform(0.7, 1.3, n), STOREY[1] * rng.uniform(0.6, 1.4, n)
    groups = np.sort(rng.integers(0, min(3, n), n))
    groups = np.unique(groups, return_inverse=True)[1]
    width, of_damping = rng.choice([0.1, 0.2, 0.3]), rng.choice([0.2, 0.4])
    factors = np.exp(width * rng.standard_normal(groups.max() + 1))
    zeta = 0.03 * np.exp(of_damping * rng.standard_normal())
    undamped = truth.chain_matrices(mass, drawn * factors[groups])
    omega, shapes = truth.modes(undamped.mass, undamped.stiffness)
    modal = undamped.mass @ shapes
    structure = undamped._replace(damping=modal @ np.diag(2.0 * zeta * omega) @ modal.T)
    motion = truth.motion(float(rng.choice([50, 100, 200])), float(rng.choice([20, 30, 60])), seed)
    dofs = np.sort(rng.choice(n, min(n, int(rng.integers(1, SENSORS + 1))), replace=False)).tolist()
    quantity = rng.choice(["absolute_acceleration"] * 4 + ["relative_displacement"])
    floors = truth.response(structure, motion)[quantity][dofs]
    values = np.vstack([motion.values(), floors])
    noise = np.array([0.005, *[rng.choice([0.01, 0.03, 0.1])] * len(dofs)])
    values += (noise * values.std(axis=1))[:, None] * rng.standard_normal(values.shape)
    names = [f"floor{dof + 1}" for dof in dofs]
    units = ["m/s^2"] + ["m" if quantity == "relative_displacement" else "m/s^2"] * len(dofs)
    header = ["time [s]", *(f"{name} [{unit}]" for name, unit in zip(["base", *names], units, strict=True))]
    rows = np.column_stack([motion.time(), values.T])
    np.savetxt(folder / "measured.csv", rows, "%.7g", ",", header=",".join(header), comments="")
    files = ", ".join(f'{name} = {{ file = "measured.csv", column = "{name}" }}' for name in ["base", *names])
    spans = [[f"k{g}", int((groups == g).sum())] for g in range(groups.max() + 1)]
    spans = ", ".join(f'["{name}", {count}]' for name, count in spans)
    lines = [
        "[data]",
        f"files = {{ {files} }}",
        'base = "base"',
        f"sensors = [{', '.join(repr(name) for name in names)}]",
        f"dofs = {dofs}",
        f'quantity = "{quantity}"',
        "[structure]",
        'type = "SpringMassChain"',
        f"mass = {mass.tolist()}",
        f"stiffness = {{ groups = [{spans}], times = {drawn.tolist()} }}",
        'damping = { type = "ModalDamping", ratios = "zeta" }',
        "[priors]",
        *(
            f'k{g} = {{ distribution = "LogNormal", mu = 0.0, sigma = {width} }}'
            for g in range(groups.max() + 1)
        ),
        f'zeta = {{ distribution = "LogNormal", mu = {np.log(0.03)}, sigma = {of_damping} }}',
        'sigma = { distribution = "HalfNormal", sigma = 0.5 }',
        "[likelihood]",
        'kinds = ["NORM"]',
        'sigma = "sigma"',
        "",
    ]
    path = folder / "update.toml"
    path.write_text("\n".join(lines))
    return path, omega / (2.0 * np.pi), zeta
