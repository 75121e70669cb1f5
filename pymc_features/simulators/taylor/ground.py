"""The ground acceleration as polynomials, each over a span of the record that a chain takes in whole steps.

Between two samples it is linear. Where outputs are wanted at every tenth sample only, a step for each sample
would be much shorter than the motion needs. Then the record of several samples becomes one polynomial, its
projection (`projection.py`): the remainder r has no moments up to the polynomial's degree. It pushes the
chain to and fro, and what is left of that at the end of a span of length T is small where omega T is. Within
the span it moves the chain by its second integral, so that the acceleration is wrong by no more than

    omega^2 max(1, omega T) max |integral of the integral of r|,

and after a reversal within the span it may stay so. That must be below `TOLERANCE` of the peak of the record.

Polynomials with large coefficients want many steps. Their number is estimated by what the load alone gives
to the last coefficients of the velocities: that of g_k, k! / P! (omega H)^(P - 1 - k) H^2 g_k, with an even
exponent. Between two outputs the spans are those divisors of `stride` for which it is smallest, single steps
of the recursion if they are not more.

Projection of a function that is linear between samples on polynomials, and what it loses.
"""

from functools import cache, lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial, legendre

from pymc_features.simulators.oscillators.arguments import Excitation, n_outputs

DEGREE = 5  # of the ground acceleration in a step
POINTS = 2  # to a sample, where the second integral is looked at


def twice_integrated(values, step):
    """Second integral from the first point, of functions (p, ...) that are linear between points."""
    once = np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0)
    before = np.concatenate([np.zeros_like(once[:1]), once[:-1]])
    return np.cumsum(step * before + step**2 / 6.0 * (2.0 * values[:-1] + values[1:]), axis=0)


@cache
def projection(width):
    """Matrices that take the samples of a span, whose time goes from 0 to 1, to its polynomial and remainder.

    The polynomial has the moments of the samples up to its degree: its coefficients by Legendre polynomials
    are theirs.

    Returns
    -------
    coefficients : array (width + 1, DEGREE + 1)
    remainder : array (width + 1, POINTS width)
        Second integral of the remainder.
    """
    hats, degrees = np.eye(width + 1), np.arange(DEGREE + 1)
    nodes, weights = legendre.leggauss(DEGREE)
    times = (np.arange(width)[:, None] + 0.5 * (nodes + 1.0)).ravel() / width
    values = np.array([np.interp(times, np.arange(width + 1) / width, hat) for hat in hats])
    values = values * np.tile(0.5 * weights / width, width)
    moments = values @ legendre.legvander(2.0 * times - 1.0, DEGREE) * (2 * degrees + 1)
    powers = [legendre.Legendre.basis(k, domain=[0.0, 1.0]) for k in degrees]
    powers = [p.convert(kind=Polynomial).coef for p in powers]
    coefficients = moments @ np.array([np.pad(p, (0, DEGREE + 1 - p.size)) for p in powers])
    points = np.arange(POINTS * width + 1) / (POINTS * width)
    linear = np.array([np.interp(points, np.arange(width + 1) / width, hat) for hat in hats])
    of_samples = twice_integrated(linear.T, points[1]).T
    shares = 1.0 / ((degrees + 1) * (degrees + 2))
    of_polynomial = coefficients @ (shares[:, None] * points[1:] ** (degrees[:, None] + 2))
    return coefficients, of_samples - of_polynomial


TOLERANCE = 5e-6  # of the peak of the ground acceleration
EXCESS = 30.0  # of the estimate over the last coefficients that are met: with it times were least
SHARE = 0.5  # of the load's last coefficient, times (omega H)^2: that much of it counts as an error
LARGEST_PHASE = 8.0  # of omega T: longer spans would be divided into many steps again


class Spans(NamedTuple):
    """A record, cut into spans.

    Attributes
    ----------
    loads : array (spans + 1, DEGREE + 1)
        Coefficients of the ground acceleration [m/s^2], its value at the end of the record last. Time counts
        in units of the span.
    widths : integer array (spans + 1,)
        Lengths of the spans, in steps of the recursion; that of the last one twice.
    first : integer array (u,)
        The span that begins at each output sample.
    ground : array (u,)
        Ground acceleration at the output samples [m/s^2].
    step : float
        Of the recursion [s].
    rate : float
        The largest rate of change [rad/s] of chains that they are meant for.
    """

    loads: np.ndarray
    widths: np.ndarray
    first: np.ndarray
    ground: np.ndarray
    step: float
    rate: float


@lru_cache(maxsize=8)
def ground_from(samples, dt, substeps, stride):
    """The ground acceleration of an excitation whose samples are given as bytes."""
    return Ground(Excitation(np.frombuffer(samples), dt, substeps, stride))


def ground_of(excitation):
    """The ground acceleration of an excitation; it is kept, for populations are evaluated many times."""
    return ground_from(excitation.acceleration.tobytes(), *excitation[1:4])


class Ground:
    """The ground acceleration of an excitation, to be cut into spans."""

    def __init__(self, excitation):
        acceleration, dt, substeps, stride, _ = excitation
        self.step, self.stride = dt / substeps, stride
        self.intervals = n_outputs(acceleration.size, substeps, stride) - 1
        sample, part = np.divmod(np.arange(self.n_steps + 1), substeps)
        ahead = np.minimum(sample + 1, acceleration.size - 1)
        rise = acceleration[ahead] - acceleration[sample]
        self.acceleration = acceleration[sample] + part / substeps * rise
        self.peak = np.abs(acceleration).max()
        self.widths = [w for w in range(stride, 1, -1) if stride % w == 0 and substeps == 1]
        self.known, self.cuts = {}, {}

    @property
    def n_steps(self) -> int:
        """Steps of the recursion."""
        return self.intervals * self.stride

    def windows(self, width):
        """The record in spans of a width, (spans, width + 1)."""
        rows = np.lib.stride_tricks.sliding_window_view(self.acceleration, width + 1)[::width]
        return np.ascontiguousarray(rows)  # those that overlap are slow to multiply

    def bounds(self, width):
        """What spans of a width do at most between two outputs (..., u - 1).

        The second integral of the remainder [m], and the coefficients (DEGREE + 1, u - 1) of the polynomials.
        """
        if width not in self.known:
            coefficients, remainder = projection(width)
            windows = self.windows(width)
            lost = np.abs(windows @ remainder).max(axis=1) * (width * self.step) ** 2
            loads = np.maximum(np.abs(windows @ coefficients), np.abs(windows[:, ::-1] @ coefficients))
            lost, loads = (x.reshape(self.intervals, -1, *x.shape[1:]).max(axis=1) for x in (lost, loads))
            self.known[width] = lost, loads.T
        return self.known[width]

    def n_steps_in(self, width, rate, series):
        """Number of steps between two outputs (u - 1,) for the load; infinite where too much is lost."""
        lost, loads = self.bounds(width)
        order, phase, least = series.order, rate * width * self.step, 1.0
        scale = EXCESS * series.tolerance * (self.peak or 1.0)
        for k in range(min(DEGREE, order - 1) + 1):
            even = order - 1 - k + (order - 1 - k) % 2
            if even == 0:  # of this coefficient a share is an error
                even, last = 2, SHARE * phase**2 / order
            else:
                last = factorial(k) / factorial(order) * phase**even
            least = np.maximum(least, (last * loads[k] / scale) ** (1.0 / (k + even)))
        is_small = rate**2 * max(1.0, phase) * lost <= TOLERANCE * self.peak
        return np.where(is_small, self.stride // width * least, np.inf)

    def widths_for(self, rate, series):
        """The widths of the spans between two outputs (u - 1,) with the fewest steps."""
        widths, least = np.ones(self.intervals, dtype=np.int64), np.full(self.intervals, float(self.stride))
        for width in self.widths:
            if rate * width * self.step <= LARGEST_PHASE:
                steps = self.n_steps_in(width, rate, series)
                widths[steps < least] = width
                least = np.minimum(steps, least)
        return widths

    def spans(self, rate, series) -> Spans:
        """The spans for chains of a largest rate of change [rad/s], which is rounded up."""
        level = (np.ceil(2.0 * np.log2(rate)) if self.widths else 0.0, series.order, series.tolerance)
        if level not in self.cuts:
            rate = 2.0 ** (0.5 * level[0])
            self.cuts[level] = self.cut(rate, self.widths_for(rate, series))
        return self.cuts[level]

    def cut(self, rate, widths) -> Spans:
        """The record in spans of given widths between two outputs (u - 1,)."""
        counts = self.stride // widths
        first = np.concatenate([[0], np.cumsum(counts)])
        own = np.repeat(widths, counts)
        starts = np.concatenate([[0], np.cumsum(own)])
        loads = np.zeros((starts.size, DEGREE + 1))
        loads[:, 0] = self.acceleration[starts]
        loads[:-1, 1] = np.diff(loads[:, 0])
        for width in np.unique(own[own > 1]):
            rows = np.flatnonzero(own == width)
            loads[rows] = self.windows(width)[starts[rows] // width] @ projection(int(width))[0]
        ground = self.acceleration[:: self.stride].copy()  # one type for all strides
        own = np.append(own, own[-1] if own.size else 1)
        return Spans(loads, own, first, ground, self.step, rate)
