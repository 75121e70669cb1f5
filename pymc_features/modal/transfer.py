"""Modes fitted to responses with known input: frequency response functions, or channels and their excitation.

At s = decay + 2 pi i f, the response a to inputs X_r is

    Y_a = sum_n p_na sum_r p_nr X_r g_n + sum_r sum_j c_arj s^(q + j) X_r,
    g_n = s^q / (s^2 + 2 zeta_n w_n s + w_n^2),

with q = 2 for accelerations, 1 for velocities, 0 for displacements. The real c stand for modes far below and
above the lines (j of `BEYOND` and `NEAR`); they follow from the lines, and are integrated out, as are modes
beside the lines.
What a record that is cut at T lacks of a response to a blow is subtracted in closed form; of a record that
neither begins nor ends at rest each mode has a free decay more, whose two amplitudes are fitted.

The modes q = (ln w, ln zeta, p_r, p_a) are fitted once, by Gauss and Newton, to all lines. With their
information matrix they stand for the data: ln L(q) = ln L(q_0) - (q - q_0)' Lambda (q - q_0) / 2.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm, t

POWERS = {"accelerance": 2, "mobility": 1, "receptance": 0}
BEYOND = -2, 0  # powers of s beside s^q of the terms for modes far below and above the lines,
NEAR = -4, -3, -2, 0, 1, 2  # and in narrow bands of a record, for modes that are not so far
RATIOS = np.geomspace(1e-5, 0.1, 13)  # of damping, among which that of a further mode is sought
START = 0.25  # least half of its half-power width, over the distance of lines, with which it is sought
STEPS, ENOUGH = 60, 1e-3  # of a fit at most, and gain of log-likelihood below which it ends,
ROUGHLY = 1.0  # and while modes are sought
MOST = 30  # modes
FORGOTTEN = 30.0  # e-folds by which a response has decayed at the end of a record that does not miss it
UNKNOWN = 1e-9  # of the largest relative eigenvalue: rounding leaves 3e-11, what lines know begins at 5e-6
DRIFT, LARGE = 2e-5, 1e-3  # of ln w between two references, where they do not tell it; of what is free
FEWEST = 3  # references that tell it
SMOOTHED, LEAST = 40, 100  # an unknown level of errors is averaged over this part of the lines, or so many
SAME = 0.9  # MAC of two modes that are one
OTHERS = 3  # peaks that are no modes of their own, after which no more are sought
FAINT = 0.05  # of the power in its half-power width: a mode with less of it is not seen
WIDEST, NARROW = 0.1, 0.01  # damping ratio, and width over the distance of lines, of what is no mode


class Lines(NamedTuple):
    """Lines of a spectrum, and the record that they are of."""

    frequencies: np.ndarray  # (k,) [Hz]
    power: int  # a value of `POWERS`
    decay: float = 0.0  # of an exponential window [1/s]
    duration: float = np.inf  # of the record [s]
    dt: float = np.nan  # [s]
    decays: bool = False  # whether records neither begin nor end at rest
    rest: tuple[int, ...] = BEYOND  # powers of s beside s^q of the terms for modes beside the lines

    @property
    def s(self) -> np.ndarray:
        """Laplace's variable (k,) [rad/s]."""
        return self.decay + 2j * np.pi * self.frequencies


class Experiment(NamedTuple):
    """Transforms of what acted at once, and of what followed; the input of a response function is one."""

    inputs: np.ndarray  # numbers (i,) of the references that acted
    excitation: np.ndarray  # (i, k)
    response: np.ndarray  # (a, k)
    variance: np.ndarray | None = None  # E|error|^2 (a, k), None if it is not known
    drift: float = 0.0  # by which ln w of all modes is off in it
    blow: float = np.nan  # instant of the blow [s]; NaN for other excitations


class TransferModes(NamedTuple):
    """Modes, and what the lines say of all else."""

    table: np.ndarray  # q (n, 2 + r + a): ln w [rad/s], ln zeta, p_r and p_a of each mode
    rest: np.ndarray  # (a, r, ..), of the terms of `BEYOND` or `NEAR`, over their root mean squares
    ends: np.ndarray  # amplitudes of free decays (experiment, n, 2), of no experiment where there are none

    natural = property(lambda self: np.exp(self.table[:, 0]), doc="Angular frequencies (n,) [rad/s].")
    frequencies = property(lambda self: self.natural / (2.0 * np.pi), doc="Natural frequencies (n,) [Hz].")
    ratios = property(lambda self: np.exp(self.table[:, 1]), doc="Damping ratios (n,).")
    inputs = property(lambda self: self.table[:, 2 : 2 + self.rest.shape[1]], doc="p_r (n, r).")
    outputs = property(lambda self: self.table[:, 2 + self.rest.shape[1] :], doc="p_a (n, a).")

    def chosen(self, which) -> "TransferModes":
        """Some of the modes."""
        return TransferModes(self.table[which], self.rest, self.ends[:, which])

    def moved(self, step) -> "TransferModes":
        """Modes after a step (k,) of all unknowns."""
        parts = np.split(step, np.cumsum([self.table.size, self.rest.size]))
        steps = [x.reshape(old.shape) for x, old in zip(parts, self, strict=True)]
        steps[0][:, :2] = steps[0][:, :2].clip(-0.3, 0.3)
        return TransferModes(*(x + old for x, old in zip(steps, self, strict=True)))

    def balanced(self) -> "TransferModes":
        """Modes with p_r and p_a of one root mean square, and the largest p_a positive."""
        size = [np.sqrt(np.mean(x**2, axis=1, keepdims=True)) for x in (self.inputs, self.outputs)]
        largest = np.take_along_axis(self.outputs, np.abs(self.outputs).argmax(axis=1)[:, None], axis=1)
        scale = np.sqrt(size[1] / size[0]) * np.sign(largest)
        table = np.hstack([self.table[:, :2], self.inputs * scale, self.outputs / scale])
        return TransferModes(table, self.rest, self.ends * np.abs(scale) * np.sign(largest))


class TransferFit(NamedTuple):
    """Modes fitted to lines, with the information in these."""

    modes: TransferModes
    information: np.ndarray  # Lambda of q, with all else integrated out (n (2 + r + a),) * 2
    log_likelihood: float
    chi2: float  # mean square of the residuals, over the variance of their real and imaginary parts
    criterion: float  # log-likelihood less what the Bayesian information criterion asks of all unknowns

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of q; the scale of p_r against p_a, of which the lines know nothing, has none."""
        return with_pseudo_inverse(self.information)

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of q (n, 2 + r + a)."""
        return np.sqrt(np.diag(self.covariance).clip(min=0.0)).reshape(self.modes.table.shape)


def unit_responses(natural, ratios, lines: Lines, blow=np.nan, slopes=False) -> np.ndarray:
    """g (n, k) of modes of unit mass, less what a record that is cut lacks of the response to a blow.

    With `slopes` g and its derivatives by ln w and ln zeta (3, n, k).
    """
    w, z, s = natural[:, None], ratios[:, None], lines.s
    over = 1.0 / (s**2 + 2.0 * z * w * s + w**2)
    found = s**lines.power * over
    found = np.stack(
        [found, -2.0 * w * (z * s + w) * over * found, -2.0 * w * z * s * over * found][: 1 + 2 * slopes]
    )
    if np.isfinite(blow + lines.duration + lines.dt):
        rest = lines.duration - blow
        rings = np.flatnonzero(ratios * natural * rest < FORGOTTEN)
        w, z = w[rings], z[rings]
        left_out, of_size = np.exp(-s * rest), z**2 / (1.0 - z**2)
        for pole, by_z in zip(poles(w, z), poles_by_ratio(w, z), strict=True):
            of_pole, later = sampled(pole, lines)
            left = pole**lines.power / (2j * pole.imag) * np.exp(pole * rest) * left_out * of_pole
            found[0, rings] -= left
            if slopes:  # of the power, the exponential and the sum by the pole, and of its imaginary part
                by_pole = lines.power / pole + rest + later
                found[1, rings] -= left * (by_pole * pole - 1.0)
                found[2, rings] -= left * (by_pole * by_z + of_size)
    return found if slopes else found[0]


def poles(w, z) -> tuple[np.ndarray, np.ndarray]:
    """Both poles of modes [rad/s]."""
    pole = -z * w + 1j * w * np.sqrt(1.0 - z**2)
    return pole, pole.conj()


def poles_by_ratio(w, z) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of both poles by ln zeta [rad/s]."""
    change = -z * w - 1j * w * z**2 / np.sqrt(1.0 - z**2)
    return change, change.conj()


def sampled(pole, lines: Lines) -> tuple[np.ndarray, np.ndarray]:
    """Transform of exp(pole t), t >= 0, as a sum over samples, and the derivative of its logarithm."""
    step = np.exp(pole * lines.dt) * np.exp(-lines.s * lines.dt)
    return lines.dt / (1.0 - step), lines.dt * step / (1.0 - step)


def free_decays(natural, ratios, lines: Lines) -> np.ndarray:
    """Transforms (2, n, k) of a cosine and a sine that decay from the start of the record."""
    one, other = (sampled(pole, lines)[0] for pole in poles(natural[:, None], ratios[:, None]))
    return np.stack([0.5 * (one + other), 0.5j * (other - one)])


def residual_terms(lines: Lines) -> np.ndarray:
    """Transforms (j, k), of root mean square one, of modes below and above the lines."""
    terms = np.stack([lines.s ** float(lines.power + j) for j in lines.rest])
    return terms / np.sqrt(np.mean(np.abs(terms) ** 2, axis=1, keepdims=True))


def quadratic(modes: TransferModes, experiments: Sequence[Experiment], lines: Lines, drift=0.0, gain=0.0):
    """Log-likelihood, chi2, gradient and information of all unknowns: q, rest, decays, drifts, gains.

    `drift` is the standard deviation of ln w of all modes from one reference to the next, `gain` that of the
    logarithm of the sensitivity of each sensor.
    """
    w, z, p_in, p_out = modes.natural, modes.ratios, modes.inputs, modes.outputs
    (n, n_in), n_out, n_rest = p_in.shape, p_out.shape[1], modes.rest.shape[2]
    n_columns, kinds = 3 * n + n_rest, {(e.drift, e.blow) for e in experiments}
    rest = residual_terms(lines)
    columns = {}
    for drift_of_all, blow in kinds:
        found = unit_responses(w * np.exp(drift_of_all), z, lines, blow, slopes=True)
        columns[drift_of_all, blow] = np.concatenate([*found, rest])
    sizes = [*(x.size for x in modes), n_in * (drift > 0.0), (n_in + n_out) * (gain > 0.0)]
    *places, at_drift, at_gain = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    at, at_rest, at_end = (place.reshape(x.shape) for place, x in zip(places, modes, strict=True))
    rows = np.arange(n_in * n_columns).reshape(n_in, -1)
    blocks = [np.split(row, [n, 2 * n, 3 * n]) for row in rows]
    information, gradient = np.zeros((sum(sizes),) * 2), np.zeros(sum(sizes))
    log_likelihood = square = count = 0
    for e, experiment in enumerate(experiments):
        basis = np.concatenate(
            [x * columns[experiment.drift, experiment.blow] for x in experiment.excitation]
        )
        if lines.decays:
            basis = np.concatenate([basis, *free_decays(w, z, lines)])
        for a, (y, v) in enumerate(zip(experiment.response, experiment.variance, strict=True)):
            to, linear = np.zeros((len(basis), sum(sizes))), np.zeros(len(basis))
            for r, (of_g, of_w, of_z, of_rest) in zip(experiment.inputs, blocks, strict=False):
                both = p_out[:, a] * p_in[:, r]
                linear[of_g], linear[of_rest] = both, modes.rest[a, r]
                to[of_g, at[:, 2 + r]], to[of_g, at[:, 2 + n_in + a]] = p_out[:, a], p_in[:, r]
                to[of_w, at[:, 0]] = to[of_z, at[:, 1]] = both
                to[of_rest, at_rest[a, r]] = 1.0
                if drift:
                    to[of_w, at_drift[r]] = both
                if gain:
                    to[of_g, at_gain[r]] = to[of_g, at_gain[n_in + a]] = both
            for j in range(2 * lines.decays):
                rows, end = len(basis) + np.arange((j - 2) * n, (j - 1) * n), modes.ends[e, :, j]
                linear[rows] = p_out[:, a] * end
                to[rows, at[:, 2 + n_in + a]], to[rows, at_end[e, :, j]] = end, p_out[:, a]
            off = y - linear @ basis
            root = np.sqrt(2.0 / v)
            scaled, rest_scaled = np.multiply(basis, root).view(np.float64), (off * root).view(np.float64)
            information += to.T @ (scaled @ scaled.T) @ to
            gradient += to.T @ (scaled @ rest_scaled)
            square += 0.5 * rest_scaled @ rest_scaled
            log_likelihood -= 0.5 * rest_scaled @ rest_scaled + np.sum(np.log(v))
            count += off.size
    if drift:
        information[at_drift, at_drift] += drift**-2.0
        for experiment in experiments:
            gradient[at_drift[experiment.inputs]] -= experiment.drift / drift**2
    if gain:
        information[at_gain, at_gain] += gain**-2.0
    return log_likelihood, square / count, gradient, information


def climbed(modes: TransferModes, experiments, lines, enough=ENOUGH):
    """The most likely modes uphill, and `quadratic` there, by Levenberg's and Marquardt's method."""
    damping, here = 1e-3, quadratic(modes, experiments, lines)
    for _ in range(STEPS):
        _, _, gradient, information = here
        scale = np.sqrt(np.diag(information)).clip(min=np.finfo(float).tiny)
        relative = information / np.outer(scale, scale) + (damping + 1e-9) * np.eye(len(scale))
        moved = modes.moved(np.linalg.solve(relative, gradient / scale) / scale)
        there = quadratic(moved, experiments, lines)
        gain = there[0] - here[0]
        if gain > 0.0:
            modes, here, damping = moved, there, damping / 30.0
            if gain < enough:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    return modes, here


def without_modes(modes: TransferModes, experiments, lines) -> list[Experiment]:
    """Experiments without the responses of modes, which may lie beside the lines."""
    decays = free_decays(modes.natural, modes.ratios, lines) if lines.decays else None
    found = []
    for i, e in enumerate(experiments):
        forces = modes.inputs[:, e.inputs] @ e.excitation
        g = unit_responses(modes.natural * np.exp(e.drift), modes.ratios, lines, e.blow)
        decay = np.einsum("nj,jnk->nk", modes.ends[i], decays) if lines.decays else 0.0
        found.append(e._replace(response=e.response - modes.outputs.T @ (forces * g + decay)))
    return found


def residuals(modes: TransferModes, experiments, lines) -> list[np.ndarray]:
    """What modes leave of the responses (a, k) of each experiment."""
    terms = residual_terms(lines)
    return [
        e.response - np.einsum("ait,tk,ik->ak", modes.rest[:, e.inputs], terms, e.excitation)
        for e in without_modes(modes, experiments, lines)
    ]


def with_level(modes, experiments, lines, smoothed: bool) -> list[Experiment]:
    """Experiments with the level of errors that residuals show: of each response, or along the lines."""
    off, found = residuals(modes, experiments, lines), []
    n_numbers = 2 * sum(e.response.size for e in experiments)
    n_fitted = modes.table.size - len(modes.natural) + modes.rest.size + modes.ends.size
    free = max(0.5, 1.0 - n_fitted / n_numbers)
    for e, rest in zip(experiments, off, strict=True):
        power = np.abs(rest) ** 2 / free
        level = np.mean(power, axis=1, keepdims=True)
        if smoothed:
            size = max(LEAST, power.shape[1] // SMOOTHED)
            if size < power.shape[1]:
                level = np.maximum(uniform_filter1d(power, size, axis=1, mode="nearest"), 1e-3 * level)
        found.append(e._replace(variance=np.broadcast_to(level, power.shape)))
    return found


def further_mode(modes: TransferModes, experiments, lines, passed) -> TransferModes:
    """Modes with one more, which takes most of what they leave at lines that are not passed by (k,)."""
    off = residuals(modes, experiments, lines)
    weights = [2.0 / e.variance for e in experiments]
    peaks = []  # as the lines are weighted, and as one sees them: lines far from a peak may weigh more
    for sizes in (weights, [w.mean(axis=1, keepdims=True) for w in weights]):
        power = sum((w * np.abs(x) ** 2).sum(axis=0) for w, x in zip(sizes, off, strict=True))
        peaks.append(int(np.where(passed, 0.0, power).argmax()))
    near = [np.interp([i - 1, i + 1], np.arange(len(power)), lines.frequencies) for i in np.unique(peaks)]
    natural = 2.0 * np.pi * np.concatenate([np.linspace(*ends, 9) for ends in near])
    w, z = (x.ravel() for x in np.meshgrid(natural, RATIOS))
    is_wide = z * w > START * 2.0 * np.pi * np.min(np.diff(lines.frequencies))
    w, z = w[is_wide], z[is_wide]
    g = unit_responses(w, z, lines)
    shape = len(w), modes.outputs.shape[1], modes.inputs.shape[1]
    above, below = np.zeros(shape), np.zeros(shape)
    for e, weight, x in zip(experiments, weights, off, strict=True):
        for r, acted in zip(e.inputs, e.excitation, strict=True):
            both = g * acted
            above[..., r] += (both.conj() @ (weight * x).T).real
            below[..., r] += np.abs(both) ** 2 @ weight.T
    best = int(np.sum(above**2 / below, axis=(1, 2)).argmax())
    left, size, right = np.linalg.svd(above[best] / below[best], full_matrices=False)
    root = np.sqrt(size[0])
    row = np.r_[np.log(w[best]), np.log(z[best]), root * right[0], root * left[:, 0]]
    ends = np.pad(modes.ends, ((0, 0), (0, 1), (0, 0)))
    return TransferModes(np.vstack([modes.table, row]), modes.rest, ends).balanced()


def are_seen(modes: TransferModes, experiments, lines: Lines, widest=WIDEST) -> np.ndarray:
    """Whether each mode is a peak among the lines (n,); the others stand for what is beside, or are noise.

    A peak has a share of the power in its half-power width, in units of the variance of each response.
    """
    f, (low, high) = modes.frequencies, lines.frequencies[[0, -1]]
    step, off = np.min(np.diff(lines.frequencies)), np.abs(lines.frequencies - f[:, None])
    inside = off <= np.maximum(modes.ratios * f, off.min(axis=1))[:, None]
    own, whole = np.zeros(len(f)), np.zeros(len(f))
    for e in experiments:
        g = unit_responses(modes.natural * np.exp(e.drift), modes.ratios, lines, e.blow)
        parts = g * (modes.inputs[:, e.inputs] @ e.excitation)
        weights = (1.0 if e.variance is None else 1.0 / e.variance) * np.ones(e.response.shape)
        own += np.sum(inside * np.abs(parts) ** 2 * (modes.outputs**2 @ weights), axis=1)
        whole += inside @ np.sum(weights * np.abs(modes.outputs.T @ parts) ** 2, axis=0)
    is_peak = (2.0 * modes.ratios * f > NARROW * step) & (modes.ratios < widest) & (own > FAINT * whole)
    half = np.where(np.isfinite(widest), modes.ratios * f, 0.0)
    return (low < f - half) & (f + half < high) & is_peak


def is_double(modes: TransferModes, same: float) -> bool:
    """Whether the last mode is another one once more."""
    f, z = modes.natural, modes.ratios
    near = np.abs(f - f[-1]) < 2.0 * (z + z[-1]) * f[-1]
    mac = np.ones(len(f))
    for x in (modes.inputs, modes.outputs):
        mac *= (x @ x[-1]) ** 2 / np.sum(x**2, axis=1) / (x[-1] @ x[-1])
    are_told_apart = modes.inputs.shape[1] > 1 or modes.outputs.shape[1] > 1
    return are_told_apart and bool(np.any((near & (mac > same))[:-1]))


@np.errstate(all="ignore")  # a step may lead anywhere; it is taken where the likelihood is a larger number
def fit_modes(
    experiments: Sequence[Experiment], lines: Lines, n_modes: int | None = None, *, gain=0.0
) -> TransferFit:
    """The modes that lines show, one after the other, the strongest first, and all together at the end.

    Without `n_modes` the last is one that raises the log-likelihood by more than the Bayesian information
    criterion asks of so many numbers, and is a mode of its own.
    """
    n_in, n_out = 1 + max(int(e.inputs.max()) for e in experiments), len(experiments[0].response)
    unknown = any(e.variance is None for e in experiments)
    n_ends = len(experiments) * lines.decays
    none = (0, 2 + n_in + n_out), (n_out, n_in, len(lines.rest)), (n_ends, 0, 2)
    modes = TransferModes(*map(np.zeros, none))

    def fitted(modes, experiments, smoothed=False):
        known = experiments
        if unknown:
            known = with_level(modes, experiments, lines, smoothed)
        modes, here = climbed(modes, known, lines, ENOUGH if smoothed else ROUGHLY)
        if unknown:  # the likelihood with the level that is left
            left = with_level(modes, experiments, lines, smoothed)
            here, known = quadratic(modes, left, lines), left
        return modes, here, known

    modes, here, known = fitted(modes, experiments)
    for_each = 0.5 * np.log(2.0 * sum(e.response.size for e in experiments))
    charge = (1 + n_in + n_out + 2 * lines.decays) * for_each
    charge += np.log(len(lines.frequencies))  # for any of them a mode may be at
    drift, is_told = 0.0, len(experiments) == n_in > 1
    widest = WIDEST if n_modes is None else np.inf

    def with_drifts(smoothed):
        """What references have that drift apart, and how far they do."""
        scale, shifts = drifts(modes, known, lines)
        moved = [e._replace(drift=shift) for e, shift in zip(experiments, shifts, strict=True)]
        return scale, moved, fitted(modes, moved, smoothed)

    passed, n_others = np.zeros(len(lines.frequencies), dtype=bool), 0
    while n_others < OTHERS and len(modes.natural) < MOST and not passed.all():
        if are_seen(modes, known, lines, widest).sum() == n_modes:
            break
        more, there, of_more = fitted(further_mode(modes, known, lines, passed), experiments)
        if unknown:
            more, there, of_more = fitted(more, experiments)
        if not (there[0] - here[0]) / max(1.0, there[1]) > charge:  # in units of what is left
            break
        if is_told and is_double(more, 0.0):  # references that drift apart split a peak as close modes do
            _, moved, (apart, instead, of_apart) = with_drifts(False)
            if instead[0] > there[0]:
                experiments, modes, here, known = moved, apart, instead, of_apart
                continue
        f = more.frequencies[-1]
        off = np.abs(lines.frequencies - f)
        is_inside = lines.frequencies[0] < f < lines.frequencies[-1]
        is_seen = are_seen(more, of_more, lines, widest)[-1]
        if n_modes is None and is_double(more, SAME if is_seen else 0.0):  # a misfit that its twin leaves
            passed |= off <= max(4.0 * more.ratios[-1] * f, off.min())
            n_others += 1
        else:
            modes, here, known = more, there, of_more
            n_others += is_inside and not is_seen
    for _ in range(3 if unknown else 1):
        modes, here, known = fitted(modes, experiments, True)
    if is_told:
        drift, experiments, (modes, here, known) = with_drifts(True)
    seen = are_seen(modes, known, lines, widest)
    modes = modes.chosen(np.lexsort([modes.natural, ~seen])).balanced()
    log_likelihood, chi2, gradient, information = quadratic(modes, known, lines, drift, gain)
    n, k = seen.sum(), modes.table.shape[1]
    criterion = log_likelihood - for_each * (len(gradient) - len(modes.natural))
    score, information = without_rest(gradient, information, n * k)
    step = with_pseudo_inverse(information) @ score  # what drifts and sensitivities that differ move
    modes = modes.chosen(slice(n))
    modes = modes.moved(np.pad(step, (0, modes.rest.size + modes.ends.size)))
    return TransferFit(modes, without_scale(information, modes), log_likelihood, chi2, criterion)


def drifts(modes: TransferModes, experiments, lines) -> tuple[float, np.ndarray]:
    """Standard deviation of ln w from one reference to the next, and by how much it is off at each (r,).

    The standard deviation is larger where few references tell it, as by Student's t.
    """
    n, now = len(experiments), np.array([e.drift for e in experiments])
    if n < FEWEST:
        return DRIFT, now
    *_, gradient, information = quadratic(modes, experiments, lines, drift=LARGE)
    order = np.r_[-n:0, : len(gradient) - n]
    score, information = without_rest(gradient[order], information[np.ix_(order, order)], n)
    covariance, apart = np.linalg.inv(information), np.eye(n) - 1.0 / n
    off = apart @ (now + covariance @ score)
    scatter = (off @ off - np.trace(apart @ covariance @ apart)) / (n - 1)
    scale = np.sqrt(max(scatter, 0.0)) * t.ppf(0.95, n - 1) / norm.ppf(0.95)
    return scale, off if scale else np.zeros(n)


def without_rest(gradient, information, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and information of the first unknowns, with the others integrated out."""
    across = information[:size, size:] @ with_pseudo_inverse(information[size:, size:])
    left = information[:size, :size] - across @ information[size:, :size]
    return gradient[:size] - across @ gradient[size:], left


def with_pseudo_inverse(information) -> np.ndarray:
    """Covariance of an information; zero along what it knows nothing of."""
    values, vectors, scale = known_directions(information)
    root = vectors / np.sqrt(values) / scale[:, None]
    return root @ root.T


def known_directions(information) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (d,), V (k, d) and scale (k,) with information = V diag(values) V' times scale to both sides."""
    scale = np.sqrt(np.diag(information).clip(min=0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    known = values > UNKNOWN * values.max(initial=0.0)
    return values[known], vectors[:, known], scale


def without_scale(information, modes: TransferModes) -> np.ndarray:
    """Information on q without the scale of p_r against p_a, of which there is none but by rounding."""
    n, k = modes.table.shape
    along = np.concatenate([modes.inputs, -modes.outputs], axis=1)
    apart = np.zeros((n, k, n))
    apart[np.arange(n), 2:, np.arange(n)] = along / np.linalg.norm(along, axis=1, keepdims=True)
    apart = apart.reshape(n * k, n)
    left = np.eye(n * k) - apart @ apart.T
    return left @ information @ left
