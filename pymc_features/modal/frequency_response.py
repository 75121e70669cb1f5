"""FrequencyResponse: the likelihood of measured frequency response functions, by the modes that they show."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pytensor.graph.basic import Apply
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import (
    as_list,
    check_choice,
    check_name,
    check_number,
    message,
    require,
    shown,
    warn_caller,
)
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal.matching import Assignment
from pymc_features.modal.structural_modes import modes
from pymc_features.modal.transfer import (
    POWERS,
    Experiment,
    Lines,
    TransferFit,
    fit_modes,
    known_directions,
    without_rest,
)
from pymc_features.ops.arrays import RowOp
from pymc_features.ops.batches import take_batches
from pymc_features.ops.declared import cheap_values_at_start, positive_tensor
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.simulators.request import picked_by_name
from pymc_features.structures import Structure

DIMS = "reference", "response", "frequency"
SCALES = {"sigma_f": 0.02, "sigma_zeta": 0.2, "sigma_phi": 0.1}  # of the half-normal priors
CORRELATION = 0.6  # of errors of ln f of two modes: a missing mass lowers all; 0.5 held 84 % of k1 with one
GAIN = 0.01  # of the sensitivity of a sensor
IN_PEAK = 3.0  # lines of Hann segments in a half-power width: with 2.4 damping is 5 % too large, with 2 50 %
POOR = 1.2  # mean square of residuals over their variance, above which lines alone are warned of
CLOSE, ALIKE = 0.01, 0.03  # errors of ln f and shapes that modes are matched with, where the model has less
tell = partial(warn_caller, category=ModalMatchWarning)
SIGNATURE = "(m),(m),(m,s),(e),(n,k),(d,q),(e,d,d),(s,o)->(d)"


class FrequencyResponse:
    r"""Likelihood of measured frequency response functions.

    The modes q = (ln f, ln zeta, shapes at responses and references) are fitted once to all lines. With their
    information matrix Lambda these are the data, and each mode of the model has one error, however many
    lines there are:

    .. math::

        q_0 \sim \mathcal{N}(q(\theta), S + \Lambda^{-1}), \qquad
        S = \sigma_f^2 S_f + \sigma_\zeta^2 S_\zeta + \sigma_\phi^2 S_\phi,

    so that a finer resolution or a longer record does not narrow an interval below what the model deserves.
    The correlation of the errors of ln f of two modes is 0.6, since what a model lacks, a mass for
    example, moves them together. Errors of shapes are relative to the root mean square of a shape.

    Parameters
    ----------
    name : str
        Of the variable.
    structure : Structure
        Its parameters may be random variables; modes but those of a rigid body must be damped.
    observed : Dataset
        What `io.read_frequency_response` or `signals.frequency_response` returned. Choose a band by
        ``observed.sel(frequency=slice(low, high))``; what modes beside it do to the lines is in the fit, and
        how many are among them says the Bayesian information criterion.
    responses, references : sequence of int or str, optional
        Degree of freedom of each response, and of each reference where a force acts, 0 next to the base, or
        their names. By default the labels of the data. A name that differs from a label in the sign of its
        direction, "5:+x" for "5:-x", reverses the channel. Under a motion of the base the participation of
        modes is free.
    n_modes : int, optional
        Of the model, lowest first, more than were measured so that none leaves the list; all by default.
    sigma_f, sigma_zeta, sigma_phi : tensor_like (), optional
        Standard deviations of the model's errors of ln f, ln zeta, and shapes [-]. By default half-normal
        variables ``{name}_sigma_f`` and so on, with scales of 0.02, 0.2 and 0.1.
    model_error : {"modes", None}
        None compares the lines themselves: the model is right, and only noise is wrong.

    Returns
    -------
    TensorVariable (component,)
        Misfit of the modes in standard deviations of the lines, along the directions that these know of:
        normal, observed as zero.

    Raises
    ------
    ValueError, TypeError
        If the data have no mode, the model has fewer modes than were measured, or names are not known.

    Warns
    -----
    ModalMatchWarning
        At the initial point of the model, of a peak without a mode and a mode without a peak; without
        `model_error`, where residuals are larger than their variance by more than a fifth; where Hann
        segments were too short for the damping.

    Notes
    -----
    Where a record is cut after a blow, what it lacks is in the fit; an exponential window is, too, for H is
    evaluated at decay + 2 pi i f. Sensitivities may differ by 1 %, and frequencies drift from one reference
    to the next: by 2e-5, or as three references and more show. Without variances the level of errors is that
    of the residuals. Hann segments broaden peaks, which is not in the fit: make them long (see
    `signals.frequency_response`). A mode of 10 % damping or more is taken for what is beside the lines.

    An evaluation takes the modes of the structure and a matrix of the size of q, whatever the number of
    lines. Coverage: ``python -m benchmarks --only coverage --names "frequency response"``.

    References
    ----------
    J. S. Bendat & A. G. Piersol, Random Data, 4th ed., ch. 9; M. W. Vanik, J. L. Beck & S.-K. Au, J. Eng.
    Mech. 126 (2000) 738-745.
    """

    def __new__(
        cls,
        name: str,
        structure: Structure,
        *,
        observed: "xr.Dataset | MeasuredModes",
        responses: Sequence[int] | Sequence[str] | None = None,
        references: Sequence[int] | Sequence[str] | None = None,
        n_modes: int | None = None,
        sigma_f: TensorLike | None = None,
        sigma_zeta: TensorLike | None = None,
        sigma_phi: TensorLike | None = None,
        model_error: str | None = "modes",
    ) -> TensorVariable:
        check_name(name)
        if not isinstance(structure, Structure):
            raise TypeError(message("structure", "a Structure", shown(structure)))
        if model_error is not None:
            check_choice(model_error, "model_error", ["modes"], "Or pass None.")
        given = observed if isinstance(observed, MeasuredModes) else measured_modes(observed)
        observed, fit, _ = given
        n = len(fit.modes.natural)
        is_force = observed.attrs.get("excitation", "force") == "force"
        places, signs = placed(structure, observed["response"].values, responses, "responses")
        if is_force:
            more = placed(structure, observed["reference"].values, references, "references")
            places, signs = places + more[0], np.append(signs, more[1])
        unique = sorted(set(places))
        found = modes(structure, n_modes, sensors=unique)
        shapes = found.shapes[:, [unique.index(i) for i in places]] * signs
        m, what = found.frequencies.type.shape[0], f"at least {n}, the number of modes that were measured"
        require(m is None or m >= n, message("n_modes", what, m))
        sigmas = []
        for key, value in {"sigma_f": sigma_f, "sigma_zeta": sigma_zeta, "sigma_phi": sigma_phi}.items():
            if model_error is None:
                value = pt.zeros(())
            elif value is None:
                value = pm.HalfNormal(f"{name}_{key}", SCALES[key])
            else:
                value = positive_tensor(value, key)
                require(not value.ndim, message(key, "one value", f"{value.ndim} dimensions"))
            sigmas.append(value)
        constants = standardised(fit, is_force)
        given = found.frequencies, found.damping_ratios, shapes, pt.stack(sigmas), *constants
        rv = pm.CustomDist(
            name,
            *given,
            logp=lambda value, *given: TransferLogp()(*given, value)[0],
            random=drawn,
            signature=SIGNATURE,
            observed=np.zeros(len(constants[1])),
        )
        warn_at_start(name, found, observed, fit)
        factor = observed["variance"].attrs.get("factor", 1.0) if "variance" in observed else np.nan
        chi2 = fit.chi2 * float(factor)
        if model_error is None and chi2 > POOR:
            tell(
                f"the modes leave residuals of {name} whose mean square is {chi2:.3g} times their "
                "variance: lines alone would give too narrow intervals. Leave `model_error` as it is."
            )
        return rv


class MeasuredModes(NamedTuple):
    """Frequency response functions, and the modes that they show."""

    data: xr.Dataset
    fit: TransferFit
    lines: Lines


def measured_modes(observed) -> MeasuredModes:
    """Fit modes to frequency response functions, for any number of models."""
    if not isinstance(observed, xr.Dataset) or "frequency_response" not in observed:
        advice = "Pass what `io.read_frequency_response` or `signals.frequency_response` returned."
        raise TypeError(message("observed", "frequency response functions", shown(observed), advice))
    h = observed["frequency_response"].transpose("response", "reference", "frequency").values
    f, attrs = observed["frequency"].values, observed.attrs
    is_line = len(f) > 1 and np.isfinite(h).all() and (np.diff(f) > 0.0).all() and f[0] > 0.0
    advice = "Choose a band by .sel(frequency=slice(low, high)), and leave out lines without a value."
    require(is_line, message("observed", "finite, at ascending frequencies above zero", shown(h), advice))
    variance = [None] * h.shape[1]
    if "variance" in observed:
        variance = observed["variance"].transpose(*DIMS).values
        for place in np.argwhere(~(np.isfinite(variance) & (variance > 0.0))):
            reference, response = (observed[dim].values[i] for dim, i in zip(DIMS, place, strict=False))
            got = f"another one of response {response!r} to {reference!r}"
            raise ValueError(message("variance", "positive at all lines", got, "Leave dead channels out."))
    quantity = attrs.get("quantity", "accelerance")
    require(quantity in POWERS, message("quantity", f"one of {', '.join(POWERS)}", shown(quantity)))
    numbers = {key: check_number(attrs[key], key) for key in ("decay", "duration", "dt") if key in attrs}
    lines = Lines(f, POWERS[quantity], **numbers)
    blows = observed["blow"].values if "blow" in observed else [attrs.get("blow", np.nan)] * h.shape[1]
    unit = np.ones((1, len(f)))
    experiments = [
        Experiment(np.array([r]), unit, h[:, r], variance[r], blow=float(blow))
        for r, blow in enumerate(blows)
    ]
    fit = fit_modes(experiments, lines, gain=GAIN)
    advice = "Choose a band with peaks, by .sel(frequency=slice(low, high))."
    require(len(fit.modes.table), message("observed", "lines with modes", "none with any", advice))
    return MeasuredModes(observed, fit, lines)


def placed(structure, labels, given, name: str) -> tuple[list[int], np.ndarray]:
    """Degrees of freedom of channels, and -1 for one that is measured in the opposite direction."""
    labels = [str(label) for label in labels]
    wanted = labels if given is None else as_list(given)
    is_whole, what = wanted is not None and len(wanted) == len(labels), "one for each of the"
    require(is_whole, message(name, f"{what} {len(labels)} channels", shown(given)))
    places, signs, known = [], [], structure.dof_names or ()
    what = "given for a structure whose degrees of freedom have no names"
    require(given is not None or known, message(name, what, given))
    for label, own in zip(labels, wanted, strict=True):
        sign = 1.0
        if isinstance(own, str):
            turned = own.translate(str.maketrans("+-", "-+"))
            if own not in known and turned in known:
                own, sign = turned, -1.0
            elif given is not None and own == label.translate(str.maketrans("+-", "-+")) != label:
                sign = -1.0
        [place], *_ = picked_by_name(structure, [own])
        places.append(int(place))
        signs.append(sign)
    return places, np.array(signs)


def standardised(fit: TransferFit, is_force: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """q_0 (n, k), the root R (d, n k) of the information, R S R' of each part of the model's error, and ends.

    Ends (k - 2, e) are ones where a channel of q_0, responses first, is a response, or a reference.
    """
    (n, k), n_in = fit.modes.table.shape, fit.modes.inputs.shape[1]
    order = np.r_[0, 1, 2 + n_in : k, 2 : 2 + n_in * is_force]
    kept = (np.arange(n)[:, None] * k + order).ravel()
    both = np.r_[kept, np.setdiff1d(np.arange(n * k), kept)]
    _, information = without_rest(np.zeros(n * k), fit.information[np.ix_(both, both)], kept.size)
    q_0, (values, vectors, scale) = fit.modes.table[:, order], known_directions(information)
    root = (vectors * np.sqrt(values)).T * scale
    of_end = np.eye(2)[(np.arange(len(order) - 2) >= k - 2 - n_in).astype(int), : 1 + is_force]
    sizes = np.sqrt(q_0[:, 2:] ** 2 @ of_end / of_end.sum(axis=0)) @ of_end.T
    along = root.reshape(len(root), n, -1)
    of_f = CORRELATION + (1.0 - CORRELATION) * np.eye(n)
    of_shapes = (along[:, :, 2:] * sizes).reshape(len(root), -1)
    pairs = (along[:, :, 0] @ of_f, along[:, :, 0]), (along[:, :, 1],) * 2, (of_shapes,) * 2
    return q_0, root, np.array([x @ y.T for x, y in pairs]), of_end


class Misfit(NamedTuple):
    """What the log-likelihoods of particles (b,) are made of."""

    match: np.ndarray  # number of the mode of the model that each measured one is taken for (b, n)
    scaled: np.ndarray  # shapes of these, in the scale of the measured ones (b, n, s)
    factors: np.ndarray  # by which they were multiplied (b, n, s)
    balance: np.ndarray  # of the logarithms of factors by those that each end would take alone (e, e)
    z: np.ndarray  # R (q - q_0) (b, d)
    covariance: np.ndarray  # (b, d, d)


def drawn(*given, rng=None, size=None) -> np.ndarray:
    """Draws (size, d) of the misfit, of the errors of the model and of the lines together."""
    m = misfit_of(*(x[None] for x in given[:4]), *given[4:])
    return rng.multivariate_normal(m.z[0], m.covariance[0], size=size, method="cholesky")


@np.errstate(all="ignore")  # what is not finite has no likelihood
def misfit_of(frequencies, ratios, shapes, sigmas, q_0, root, parts, of_end) -> Misfit:
    """Match modes (b, m) with the measured ones, and compare them; the last four are of `standardised`."""
    y, n_ends = q_0[:, 2:], of_end.shape[1]
    aim = y**2 @ of_end
    logs = np.log(2.0 * np.pi * frequencies), np.log(ratios)
    score = ((q_0[:, :1] - logs[0][:, None]) / np.maximum(sigmas[:, 0], CLOSE)[:, None, None]) ** 2
    size, wide = shapes**2 @ of_end, np.maximum(sigmas[:, 2], ALIKE)[:, None, None] ** 2
    for end in range(n_ends):
        products = ((y * of_end[:, end]) @ shapes.swapaxes(1, 2)) ** 2
        score += (1.0 - products / (size[:, None, :, end] * aim[:, None, end])) / wide
    match = Assignment().run([-0.5 * score])[0].argmax(axis=-1)
    own, size = (np.take_along_axis(x, match[..., None], axis=1) for x in (shapes, size))
    # of both ends the product is what was measured
    balance = np.eye(n_ends) - (n_ends - 1.0) / n_ends
    factors = np.exp(0.5 * np.log(aim / size) @ balance) @ of_end.T
    sense = np.sum(own * factors * y, axis=2, keepdims=True)
    factors = np.where(sense < 0.0, -factors, factors)
    logs = [np.take_along_axis(x, match, axis=1)[..., None] for x in logs]
    off = np.concatenate([*logs, own * factors], axis=2) - q_0
    z = off.reshape(len(off), -1) @ root.T
    covariance = np.eye(len(root)) + np.tensordot(sigmas**2, parts, 1)
    return Misfit(match, own * factors, factors, balance, z, covariance)


class TransferLogp(RowOp):
    """Log-likelihood of the measured modes, and its gradient by what the model gives.

    Inputs are frequencies (m,) [Hz], damping ratios (m,) and shapes (m, s) of the model, the errors (3,) of
    ln f, ln zeta and shapes; and as constants those of `standardised`, and the data (d,), zero.
    """

    ndims = 1, 1, 2, 1
    n_slopes = n_connected = len(ndims)
    simulates = True

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        return Apply(self, inputs, self.outputs(inputs))

    def of_rows(self, rows, constants, n) -> tuple[np.ndarray, ...]:
        """Log-likelihoods (n,) and gradients."""
        return logp_and_gradient(*(np.broadcast_to(x, (n, *x.shape[1:])) for x in rows), *constants)

    def pullback(self, inputs, outputs, cotangents):
        """By the other outputs."""
        return self.pulled_back(cotangents[0], inputs, outputs[1:])


take_batches(TransferLogp, first=TransferLogp.n_slopes)
run_in_python(TransferLogp)


def logp_and_gradient(
    frequencies, ratios, shapes, sigmas, q_0, root, parts, of_end, value
) -> tuple[np.ndarray, ...]:
    """Log-likelihoods (b,), and gradients by the first four arguments; -inf and zero where there is none."""
    m = misfit_of(frequencies, ratios, shapes, sigmas, q_0, root, parts, of_end)
    b, n = m.match.shape
    good = np.isfinite(m.z).all(axis=1) & np.isfinite(m.covariance).all(axis=(1, 2))
    logp, slopes = np.full(b, -np.inf), [np.zeros(x.shape) for x in (frequencies, ratios, shapes, sigmas)]
    if not good.any():
        return logp, *slopes
    match, z, inverse = m.match[good], m.z[good] - value, np.linalg.inv(m.covariance[good])
    alpha = np.einsum("bij,bj->bi", inverse, z)
    _, volume = np.linalg.slogdet(m.covariance[good])
    logp[good] = -0.5 * (np.sum(alpha * z, axis=1) + volume + z.shape[1] * np.log(2.0 * np.pi))
    of_q = -(alpha @ root).reshape(len(z), n, -1)
    of_parts = np.einsum("bi,jik,bk->bj", alpha, parts, alpha) - np.einsum("bik,jki->bj", inverse, parts)
    slopes[3][good] = sigmas[good] * of_parts
    rows, scaled = np.flatnonzero(good)[:, None], m.scaled[good]
    for i, values in enumerate((frequencies, ratios)):
        slopes[i][rows, match] = of_q[..., i] / np.take_along_axis(values[good], match, axis=1)
    # factors change with the sizes of shapes
    change = ((of_q[..., 2:] * scaled) @ of_end @ m.balance) / (scaled**2 @ of_end)
    slopes[2][rows, match] = (of_q[..., 2:] - change @ of_end.T * scaled) * m.factors[good]
    return logp, *slopes


def warn_at_start(name, found, observed, fit: TransferFit) -> None:
    """Name a peak that short segments widen; peaks without a mode, and the reverse, at the start of a model.

    Refuse undamped modes.
    """
    if observed.attrs.get("window") == "hann":
        duration, peaks = observed.attrs["duration"], fit.modes.frequencies
        counts = 2.0 * fit.modes.ratios * peaks * duration
        if counts.min() < IN_PEAK:
            tell(
                f"Hann segments of {duration:.4g} s are short for the damping of the mode at "
                f"{peaks[counts.argmin()]:.4g} Hz, which will look larger: {counts.min():.2g} lines lie in "
                f"its half-power width. Take segments of {duration * IN_PEAK / counts.min():.2g} s and more."
            )
    if (values := cheap_values_at_start([found.frequencies, found.damping_ratios])) is None:
        return
    f, ratios = values
    n, bends = len(fit.modes.table), f > 0.0
    got = f"ratios of {ratios[bends].min(initial=np.inf):.3g}"
    is_damped = (ratios[bends] > 0.0).all()
    require(is_damped, message("structure", "damped in all modes but those of a rigid body", got))
    got = f"{len(f)}, {(f == 0.0).sum()} of them of a rigid body"
    require(bends.sum() >= n, message("n_modes", f"more than {n}, those that were measured", got))
    low, high = observed["frequency"].values[[0, -1]]
    inside, peaks = f[(f > low) & (f < high)], fit.modes.frequencies
    if len(inside) != len(peaks):
        few, many = ("peak", "modes") if len(peaks) < len(inside) else ("mode", "peaks")
        seen, own = (", ".join(f"{x:.4g}" for x in some) or "none" for some in (peaks, inside))
        tell(
            f"{name} shows {len(peaks)} modes between {low:.4g} and {high:.4g} Hz, at {seen} Hz, and the "
            f"model has {len(inside)} there at its initial point, at {own} Hz: some {many} have no {few}. "
            "Choose another band, by .sel(frequency=slice(low, high)), or the start of the parameters."
        )
