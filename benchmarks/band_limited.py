"""How far responses are off under band-limited motions: `python -m benchmarks.band_limited`.

Structures of every family, by the highest natural frequency over the sampling rate, and their truth by
`benchmarks.truth`. The tests take both from here.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

import pymc_features as pmf
from benchmarks import truth
from benchmarks.tables import table

RATES = (50.0, 100.0, 200.0)  # Hz
DURATION, SHORTER = 14.0, 10.0  # s, of linear structures and of others; the ends are quiet for two
MASS, SPRINGS = np.array([1.0, 2.0, 1.5]), np.array([1.0, 0.8, 0.6])  # the latter to be scaled
RATIO = 0.02  # damping of the first and the last mode
RIGID = np.array([1.0, 1.5e4, 0.6])  # the last mode is 170 times as fast as the one before
SUPPORTS = np.array([[0.8, 0.2], [0.5, 0.5], [0.1, 0.9]])
PLACES = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, 2.0]])  # degree of freedom, force
OUTPUTS = np.array([[0.5, 0.5, 0.0], [-1.0, 0.0, 1.0]])
YIELD, HARDEN = 0.3, 0.5  # over the largest drift of the linear chain
POST_YIELD = 0.1
KINDS = ("band-limited", "linear")
QUANTITIES = (
    "absolute_acceleration",
    "relative_acceleration",
    "relative_velocity",
    "relative_displacement",
    "inter_storey_drift",
    "base_shear",
)
# share of the rate: bound. At 3.3 and 33.3 straight lines, whose corners repeat the band around each multiple
# of the rate, excite a mode; at 3 and 30 hardly.
SINGLE = {0.15: 5e-4, 0.8: 1e-3, 3.0: 1.5e-2, 3.3: 1.5e-2, 30.0: 1e-4, 33.3: 1e-4, 1e6: 1e-4}


class Case(NamedTuple):
    """A structure of the package and its `truth.Linear`, with `truth.Springs` if it is not linear."""

    structure: object
    linear: truth.Linear
    n_modes: int | None = None
    springs: truth.Springs | None = None

    def motion(self, rate, ends="quiet", seed=1):
        """As many histories as act on it."""
        places = self.linear.influence if self.linear.places is None else self.linear.places
        duration = DURATION if self.springs is None else SHORTER
        return truth.motion(rate, duration, seed, ends=ends, n_inputs=places.shape[1])

    def exact(self, moved, fine=1):
        """Its response by quantity, by the truth; combinations S x as "outputs: ..."."""
        if self.springs is None:
            found = truth.response(self.linear, moved, n_modes=self.n_modes, fine=fine)
        else:
            found = truth.spring_response(
                MASS, self.linear.damping, self.springs, moved, fine=fine, rtol=1e-7
            )
        if not self.structure.has_storeys:
            del found["inter_storey_drift"]
        if len(self.linear.mass) != OUTPUTS.shape[1]:
            return found
        kernels = [name for name in found if name.startswith(("relative", "absolute"))]
        return found | {f"outputs: {name}": OUTPUTS @ found[name] for name in kernels}

    def load(self, moved, fine=1, **settings):
        """What the package is given of a motion."""
        values, dt = moved.values(fine), 1.0 / (moved.rate * fine)
        if self.linear.places is not None:
            return pmf.Loading(values, dt, kind="force", matrix=self.linear.places, **settings)
        return (
            pmf.Record(values[0], dt, **settings) if len(values) == 1 else pmf.Loading(values, dt, **settings)
        )

    def simulated(self, load, quantity, dt=None):
        """The package's response (row, time) by a name of `exact`."""
        outputs = OUTPUTS if quantity.startswith("outputs: ") else None
        return np.atleast_2d(
            pmf.simulate(
                self.structure,
                load,
                dt=dt,
                quantity=quantity.removeprefix("outputs: "),
                n_modes=self.n_modes,
                outputs=outputs,
            ).values
        )


def error(found, expected):
    """Largest difference over the largest value."""
    return np.abs(found - expected).max() / np.abs(expected).max()


def cases(highest) -> dict[str, Case]:
    """Linear structures whose highest natural frequency [Hz] is given, by name.

    Of the one with a rigid storey it is the last but one.
    """
    unit = truth.chain_matrices(MASS, SPRINGS)
    w = truth.modes(unit.mass, unit.stiffness)[0]
    w, k = w * 2.0 * np.pi * highest / w[-1], (2.0 * np.pi * highest / w[-1]) ** 2
    pair = 2.0 * RATIO / (w[0] + w[-1]) * np.array([w[0] * w[-1], 1.0])
    chain = truth.chain_matrices(MASS, k * SPRINGS, pair)
    coupled = chain._replace(damping=chain.damping + np.diag([0.0, 0.0, 0.03 * w[-1]]))
    rayleigh, (m, c, stiffness) = pmf.RayleighDamping(*pair), coupled[:3]

    def matrices(damping, influence=None):
        return pmf.LinearStructure(m, stiffness=stiffness, damping=damping, influence=influence)

    term = np.zeros((3, 3))
    term[0, 0] = 0.5 * k * SPRINGS[0]
    affine = pmf.AffineStructure(
        m, stiffness=stiffness - term, damping=rayleigh, stiffness_terms=[term], theta=[1.0]
    )
    return {
        "chain": Case(pmf.SpringMassChain(MASS, k * SPRINGS, rayleigh), chain),
        "LinearStructure": Case(matrices(rayleigh), chain),
        "AffineStructure": Case(affine, chain),
        "coupled damping": Case(matrices(c), coupled),
        "two supports": Case(matrices(rayleigh, SUPPORTS), chain._replace(influence=SUPPORTS)),
        "forces": Case(matrices(rayleigh), chain._replace(places=PLACES)),
        "forces, coupled": Case(matrices(c), coupled._replace(places=PLACES)),
        "rigid storey": with_rigid_storey(highest),
        "two modes": Case(matrices(rayleigh), chain, 2),
        "two modes, coupled": Case(matrices(c), coupled, 2),
        "two modes, forces": Case(matrices(rayleigh), chain._replace(places=PLACES), 2),
    }


def with_rigid_storey(second) -> Case:
    """A chain with a storey that hardly moves, by the frequency of its second mode [Hz]; modal damping."""
    unit = truth.chain_matrices(MASS, RIGID)
    springs = (2.0 * np.pi * second / truth.modes(unit.mass, unit.stiffness)[0][1]) ** 2 * RIGID
    exact = truth.chain_matrices(MASS, springs)
    w, shapes = truth.modes(exact.mass, exact.stiffness)
    moved = exact.mass @ shapes
    exact = exact._replace(damping=moved * (2.0 * RATIO * w) @ moved.T)
    return Case(pmf.SpringMassChain(MASS, springs, pmf.ModalDamping(RATIO)), exact)


def yielding(highest, moved) -> dict[str, Case]:
    """Chains that yield and that harden under a motion; the highest frequency [Hz] is of small motions."""
    linear = cases(highest)["chain"]
    k, damping = linear.structure.stiffness, linear.structure.damping
    drift = np.abs(linear.exact(moved)["inter_storey_drift"]).max()
    d_y, cubic = YIELD * drift, HARDEN * k / drift**2
    hysteretic = pmf.HystereticChain(MASS, k, damping, yield_displacement=d_y, post_yield_ratio=POST_YIELD)
    return {
        "HystereticChain": Case(hysteretic, linear.linear, None, truth.Springs(k, d_y, POST_YIELD)),
        "DuffingChain": Case(
            pmf.DuffingChain(MASS, k, damping, cubic), linear.linear, None, truth.Springs(k, cubic=cubic)
        ),
    }


def oscillator(frequency) -> Case:
    """One mass with a natural frequency [Hz]."""
    w = 2.0 * np.pi * frequency
    structure = pmf.SpringMassChain([1.0], [w**2], pmf.ModalDamping(RATIO))
    one = np.eye(1)
    return Case(structure, truth.Linear(one, 2.0 * RATIO * w * one, w**2 * one, one))


def errors(case, moved, expected, settings):
    """Largest error over the peak, by quantity."""
    load = case.load(moved, **settings)
    return {name: error(case.simulated(load, name), values) for name, values in expected.items()}


def main():
    """Print the errors of families, quantities and rates, and of single modes, of both kinds of record."""
    rows = []
    for share, rate in product((0.15, 0.3), RATES):
        chosen = cases(share * rate) | yielding(share * rate, truth.motion(rate, SHORTER, 1))
        for name, case in chosen.items():
            rows += rows_of(name, case, rate, share)
    titles = [q.replace("_", " ") for q in QUANTITIES]
    print(table(["structure", "mode / rate", "Hz", "samples joined", *titles, "outputs"], rows), flush=True)
    rows = [
        [f"{share:g}", f"{bound:g}", *(f"{worst_of_single(share, kind):.1e}" for kind in KINDS)]
        for share, bound in SINGLE.items()
    ]
    print("\nAbsolute acceleration of one mode, the worst of the rates\n")
    print(table(["mode / rate", "bound", *KINDS], rows))


def rows_of(name, case, rate, share):
    """A row for each way of joining samples."""
    moved = case.motion(rate)
    expected, rows = case.exact(moved), []
    for kind in KINDS:
        found = errors(case, moved, expected, {"interpolation": kind})
        outputs = max(e for quantity, e in found.items() if quantity.startswith("outputs"))
        cells = [f"{found[q]:.1e}" if q in found else "" for q in QUANTITIES]
        rows.append([name, share, f"{rate:g}", kind, *cells, f"{outputs:.1e}"])
    return rows


def worst_of_single(share, kind):
    """Largest error of the absolute acceleration of one mode over the rates."""
    found = []
    for rate in RATES:
        case = oscillator(share * rate)
        moved = case.motion(rate)
        expected = {"absolute_acceleration": case.exact(moved)["absolute_acceleration"]}
        found += errors(case, moved, expected, {"interpolation": kind}).values()
    return max(found)


if __name__ == "__main__":
    main()
