"""Models that are not the structure, and noise on the base: what calibrated intervals of one event contain.

Four families: three storeys with all floors measured, eight with two, four with a brace over two storeys,
given by matrices, with two, and ten with three, every spring of which is unknown. Each event is another
motion. The value sought is the one that fits all events best: the mean of the maxima, weighted by their
information. Truth by `benchmarks.truth`.
"""

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import make_interp_spline

import pymc_features as pmf
from benchmarks import truth
from benchmarks.coverage.errors import first_order
from benchmarks.tables import table
from pymc_features.calibration.maxima import climb_likelihood
from pymc_features.calibration.residuals import Comparison, Coordinates
from pymc_features.calibration.sandwich import Peak

EVENTS, QUICK_EVENTS = 400, 12
BLOCK = 20  # events of each truth and family, after which the table is printed
RECORDS, QUICK_RECORDS = 100, 4  # data sets with gaps, and of several records
RATE, DURATION, LEVEL = 50.0, 20.0, 0.02  # Hz, s, noise over the rms of the response
WIDE = 1.645  # standard deviations of 90 %
UNUSUAL = 1.0  # ln of a factor from the median: another maximum, which does not count for the best value
DAMPING = 0.3, 6e-4  # alpha [1/s], beta [s]


class Family(NamedTuple):
    """Masses [kg], springs [N/m] as (from, to, stiffness, group), -1 the base; sensors; number of groups."""

    n: int
    springs: list[tuple[int, int, float, int]]
    sensors: list[int]
    n_groups: int

    def matrices(self, factors, damping=1.0):
        """M, C, K (n, n) with a factor of each group of springs, and one of the damping."""
        stiffness = np.zeros((self.n, self.n))
        for i, j, k, group in self.springs:
            axis = np.zeros(self.n)
            axis[j] = 1.0
            if i >= 0:
                axis[i] = -1.0
            stiffness += factors[group] * k * np.outer(axis, axis)
        mass = np.eye(self.n)
        return mass, damping * (DAMPING[0] * mass + DAMPING[1] * stiffness), stiffness


def storeys(n, k, groups):
    """Springs from floor to floor."""
    return [(i - 1, i, k, groups[i]) for i in range(n)]


FAMILIES = {
    "three storeys": Family(3, storeys(3, 1200.0, [0, 1, 2]), [0, 1, 2], 3),
    "eight storeys": Family(8, storeys(8, 2500.0, [0, 0, 0, 1, 1, 1, 2, 2]), [3, 7], 3),
    "braced frame": Family(4, [*storeys(4, 1200.0, [0, 0, 1, 1]), (1, 3, 500.0, 2)], [1, 3], 3),
    "ten storeys": Family(10, storeys(10, 3000.0, list(range(10))), [2, 5, 9], 10),
}
OF_TEN = "right model", "mass distribution"  # truths of the ten storeys


class Tested(NamedTuple):
    """What moves, what is measured of it, the record of the base that the model gets (time,), and its noise.

    The noise is a standard deviation [m/s^2] where it is known. `errors` are those of the sensors, of unit
    variance, from a generator and a shape (sensor, time).
    """

    structure: truth.Linear
    sensors: list[int]
    gains: np.ndarray | float = 1.0
    clock: float = 0.0
    base: np.ndarray | None = None
    noise: float = 0.0
    errors: Callable = partial(first_order, dt=1.0 / RATE, time_constant=0.05)


def linear(matrices):
    """M, C, K on a base that moves as one."""
    mass, damping, stiffness = matrices
    return truth.Linear(mass, damping, stiffness, np.ones((len(mass), 1)))


def right(family, moved, rng):
    """The model itself."""
    return Tested(linear(family.matrices(np.ones(family.n_groups))), family.sensors)


def white_errors(family, moved, rng):
    """The model itself, measured with errors that are independent."""
    return right(family, moved, rng)._replace(errors=np.random.Generator.standard_normal)


def averaged_errors(family, moved, rng):
    """The model itself, measured with moving averages of eight independent errors."""

    def averages(rng, shape):
        noise = rng.standard_normal((shape[0], shape[1] + 7))
        return sliding_window_view(noise, 8, axis=1).sum(axis=-1) / np.sqrt(8.0)

    return right(family, moved, rng)._replace(errors=averages)


def other_damping(family, moved, rng):
    """Ratios of 1, 3, 1, 3, ... % instead of Rayleigh's."""
    mass, _, stiffness = family.matrices(np.ones(family.n_groups))
    omega, shapes = truth.modes(mass, stiffness)
    ratios = np.where(np.arange(family.n) % 2, 0.03, 0.01)
    damping = mass @ (shapes * (2.0 * ratios * omega)) @ shapes.T @ mass
    return Tested(linear((mass, damping, stiffness)), family.sensors)


def other_masses(family, moved, rng):
    """Between 90 and 110 % of those of the model."""
    mass, damping, stiffness = family.matrices(np.ones(family.n_groups))
    mass = mass * (1.0 + 0.1 * np.cos(2.4 * np.arange(family.n)))
    return Tested(linear((mass, damping, stiffness)), family.sensors)


def partition(family, moved, rng):
    """A spring of 4 % of a storey between the first floor and the last but one."""
    last = max(2, family.n - 2)
    more = family._replace(springs=[*family.springs, (0, last, 0.04 * family.springs[0][2], 0)])
    return right(more, moved, rng)


def soft_ground(family, moved, rng):
    """A foundation of the mass of a floor on a spring twenty times as stiff as a storey."""
    matrices = family.matrices(np.ones(family.n_groups))
    mass, damping, stiffness = (np.pad(x, ((1, 0), (1, 0))) for x in matrices)
    from_base = -stiffness[1:, 1:].sum(axis=1)
    stiffness[0, 1:] = stiffness[1:, 0] = from_base
    stiffness[0, 0] = -from_base.sum() + 20.0 * family.springs[0][2]
    mass[0, 0] = 1.0
    damping = DAMPING[0] * mass + DAMPING[1] * stiffness
    return Tested(linear((mass, damping, stiffness)), [s + 1 for s in family.sensors])


def tuned_mass(family, moved, rng):
    """0.2 % of the mass on top, at the first frequency."""
    matrices = family.matrices(np.ones(family.n_groups))
    mass, damping, stiffness = (np.pad(x, ((0, 1), (0, 1))) for x in matrices)
    omega = truth.modes(mass[:-1, :-1], stiffness[:-1, :-1])[0][0]
    small, at = 0.002 * family.n, np.array([-2, -1])
    mass[-1, -1] = small
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    stiffness[np.ix_(at, at)] += small * omega**2 * pair
    damping[np.ix_(at, at)] += 0.04 * small * omega * pair
    return Tested(linear((mass, damping, stiffness)), family.sensors)


def wrong_gains(family, moved, rng):
    """Sensors that read 3 % too much and too little in turn."""
    gains = 1.0 + 0.03 * np.where(np.arange(len(family.sensors)) % 2, 1.0, -1.0)
    return right(family, moved, rng)._replace(gains=gains[:, None])


def lag(family, moved, rng):
    """A base that is recorded 3 ms late."""
    late = moved.coefficients * np.exp(-3e-3j * moved.angular_frequencies)
    return right(family, moved, rng)._replace(base=moved._replace(coefficients=late).values()[0])


def clock(family, moved, rng):
    """Sensors whose clock is wrong by 3 in 10,000."""
    return right(family, moved, rng)._replace(clock=3e-4)


def base_noise(family, moved, rng):
    """White noise of 5 % on the record of the base."""
    values = moved.values()[0]
    noise = 0.05 * np.sqrt(np.mean(values**2)) * rng.standard_normal(values.size)
    return right(family, moved, rng)._replace(base=values + noise)


def known_base_noise(family, moved, rng):
    """The same, and its level is known."""
    level = 0.05 * np.sqrt(np.mean(moved.values() ** 2))
    return base_noise(family, moved, rng)._replace(noise=level)


TRUTHS: dict[str, Callable] = {
    "right model": right,
    "right model, white errors": white_errors,
    "right model, moving averages": averaged_errors,
    "damping form": other_damping,
    "mass distribution": other_masses,
    "partition": partition,
    "soft ground": soft_ground,
    "tuned mass of 0.2 %": tuned_mass,
    "gains of 3 %": wrong_gains,
    "lag of 3 ms": lag,
    "clock": clock,
    "base noise of 5 %": base_noise,
    "base noise of known level": known_base_noise,
}


def factors(w):
    """Those of the groups of springs, and of the damping, at a point of their logarithms and ln sigma."""
    return np.exp(w[:-2]), np.exp(w[-2])


class Predictions:
    """What `pymc_features.calibration.residuals` asks of a model: NORM with ln of factors and of sigma.

    `measured` has the record of the base (time,) and the data (sensor, time) of each event.
    """

    def __init__(self, family, measured):
        self.family, self.measured, self.count = family, measured, 0
        n = family.n_groups + 2
        self.coordinates = Coordinates(np.zeros(n, dtype=int), np.zeros(n, dtype=bool), np.zeros(n))

    def structure(self, w):
        """The model at factors."""
        mass, damping, stiffness = self.family.matrices(*factors(w))
        return pmf.LinearStructure(mass=mass, damping=damping, stiffness=stiffness)

    def frequencies(self, w):
        """Natural frequencies [Hz]."""
        f = truth.modes(*self.family.matrices(factors(w)[0])[::2])[0] / (2.0 * np.pi)
        return [f for _ in self.measured]

    def __call__(self, w):
        """The likelihood of each record."""
        self.count += 1
        return [self.value(w, *one) for one in self.measured]

    def with_noisy_base(self, w, sd, rng):
        """The same under records with white noise."""
        self.count += 1
        return [self.value(w, base + sd * rng.standard_normal(base.size), x) for base, x in self.measured]

    def value(self, w, base, data):
        """The likelihood of one record (time,) of the base, and data (sensor, time)."""
        record = pmf.Record(base, 1.0 / RATE)
        mu = pmf.simulate(self.structure(w), record, sensors=self.family.sensors).values
        claimed = (~np.isnan(data)).sum(axis=1)
        return Comparison(mu, data, np.exp(w[-1]), claimed, step=1.0 / RATE).by_sensor()


class Outcome(NamedTuple):
    """Maximum (p,), its information (p, p), standard deviations (p,) without and with corrections, growth."""

    maximum: np.ndarray
    information: np.ndarray
    plain: np.ndarray
    corrected: np.ndarray
    growth: float


def measurement(family, respond, seed):
    """What moves, its record of the base (time,), data (sensor, time), and the level of their errors."""
    rng, moved = np.random.default_rng([13, seed]), truth.motion(RATE, DURATION, 1000 + seed, ends="moving")
    what = respond(family, moved, rng)
    fine = 8 if what.clock else 1
    exact = truth.response(what.structure, moved, fine=fine)["absolute_acceleration"][what.sensors]
    if what.clock:
        t = moved.time() * (1.0 - what.clock)
        exact = make_interp_spline(moved.time(fine), exact, k=5, axis=1)(t)
    exact = what.gains * exact
    level = LEVEL * np.sqrt(np.mean(exact**2))
    data = exact + level * what.errors(rng, exact.shape)
    return what, moved.values()[0] if what.base is None else what.base, data, level


def with_gaps(data):
    """Data (sensor, time) of which 30 % of the record are missing in the first sensor, 20 % in the last."""
    data, n = data.copy(), data.shape[1]
    data[0, int(0.25 * n) : int(0.55 * n)] = data[-1, int(0.65 * n) : int(0.75 * n)] = np.nan
    data[-1, int(0.45 * n) : int(0.55 * n)] = np.nan
    return data


def outcome(family, respond, seed, n_records=1, change=None) -> Outcome:
    """What one event says of the factors (p,), the damping's among them, or several in one model.

    `change` is made to the data (sensor, time) of each.
    """
    some = [measurement(family, respond, seed * n_records + i) for i in range(n_records)]
    what, level = some[0][0], some[0][3]
    pairs = [(base, data if change is None else change(data)) for _, base, data, _ in some]
    predictions = Predictions(family, pairs)
    fit = climb_likelihood(predictions, np.append(np.zeros(family.n_groups + 1), np.log(level)))
    p = family.n_groups + 1
    plain = Peak.at(fit, None, leverage=False)
    corrected = Peak.at(fit, None if what.noise else "bands")
    if what.noise:
        corrected = corrected.with_base_noise(predictions, what.noise)
    sd = [peak.deviations[:p] for peak in (plain, corrected)]
    return Outcome(fit.w[:p], fit.information[:p, :p], *sd, corrected.growth)


def covers(outcomes):
    """Shares (2, p) of intervals that contain the best value, without and with corrections."""
    maxima = np.array([one.maximum for one in outcomes])
    usual = np.abs(maxima - np.median(maxima, axis=0)).max(axis=1) < UNUSUAL
    some = [one for one, is_usual in zip(outcomes, usual, strict=True) if is_usual]
    total = sum(one.information for one in some)
    best = np.linalg.solve(total, sum(one.information @ one.maximum for one in some))
    off = np.abs(maxima - best)
    return [
        np.mean(off < WIDE * np.array([getattr(one, name) for one in outcomes]), axis=0)
        for name in ("plain", "corrected")
    ]


def told(outcomes) -> str:
    """Coverage without and with corrections, and how much wider intervals are with them."""
    plain, corrected = covers(outcomes)
    wider = np.array([one.corrected / one.plain for one in outcomes])
    return (
        f"{100 * plain.mean():.0f}, {100 * corrected.mean():.0f} ({100 * corrected.min():.0f}); "
        f"{np.median(wider):.2f}, {wider.mean():.2f}"
    )


def run_records(quick=False):
    """Print the same of data with gaps, and of two records in one model."""
    n, start, rows = QUICK_RECORDS if quick else RECORDS, time.perf_counter(), []
    cases = {"with gaps": {"change": with_gaps}, "two records": {"n_records": 2}}
    for of in ("braced frame", "three storeys"):
        for name in ("mass distribution", "damping form", "right model"):
            all_of = [
                [outcome(FAMILIES[of], TRUTHS[name], seed, **case) for seed in range(n)]
                for case in cases.values()
            ]
            rows.append([f"{of}, {name}", *map(told, all_of)])
            print(" | ".join(rows[-1]), flush=True)
    print(
        f"\n## Gaps, and two records: {n} data sets each, {time.perf_counter() - start:.0f} s\n\nHow many of "
        "100 intervals contain the best value: without corrections, with them (lowest parameter); widths "
        "over those without, median and mean.\n"
    )
    print(table(("family, truth", *cases), rows))


def kept_outcomes(path) -> dict:
    """Outcomes by truth, family and seed, from a file with one in each line; none where it is not there."""
    lines = Path(path).read_text().splitlines() if path and Path(path).exists() else []
    return {tuple(key): Outcome(*map(np.array, values)) for key, values in map(json.loads, lines)}


def run_model_errors(quick=False, path=None):
    """Print coverage of the best value without and with corrections, and widths, by error and family.

    The table is printed anew after each block of events. A file at `path` keeps each event: a run that was
    ended goes on from it.
    """
    n, start, known = QUICK_EVENTS if quick else EVENTS, time.perf_counter(), kept_outcomes(path)
    cells = {(name, of): [] for name in TRUTHS for of in FAMILIES if of != "ten storeys" or name in OF_TEN}
    for first in range(0, n, BLOCK):
        for (name, of), some in cells.items():
            for seed in range(first, min(n, first + BLOCK)):
                if (name, of, seed) not in known:
                    one = known[name, of, seed] = outcome(FAMILIES[of], TRUTHS[name], seed)
                    if path:
                        line = json.dumps([[name, of, seed], [np.asarray(x).tolist() for x in one]])
                        with open(path, "a") as file:
                            file.write(line + "\n")
                some.append(known[name, of, seed])
        rows = [
            [name, *(told(cells[name, of]) if (name, of) in cells else "-" for of in FAMILIES)]
            for name in TRUTHS
        ]
        print(
            f"\n## What is not in the model: {len(some)} events each, {time.perf_counter() - start:.0f} s\n\n"
            "How many of 100 intervals contain the best value: without corrections, with them (lowest "
            "parameter); widths over those without, median and mean.\n"
        )
        print(table(("truth", *FAMILIES), rows), flush=True)
