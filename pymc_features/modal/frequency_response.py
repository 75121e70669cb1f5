"""FrequencyResponse: the likelihood of measured frequency response functions, by the modes that they show."""

import itertools
from collections.abc import Sequence
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
SIGNATURE = "(m),(m),(m,s),(e),(n,k),(d,q),(e,d,d),()->(d)"


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
        if (m := found.frequencies.type.shape[0]) is not None and m < n:
            raise ValueError(message("n_modes", f"at least {n}, the number of modes that were measured", m))
        sigmas = []
        for key, value in {"sigma_f": sigma_f, "sigma_zeta": sigma_zeta, "sigma_phi": sigma_phi}.items():
            if model_error is None:
                value = pt.zeros(())
            elif value is None:
                value = pm.HalfNormal(f"{name}_{key}", SCALES[key])
            else:
                value = positive_tensor(value, key)
                if value.ndim:
                    raise ValueError(message(key, "one value", f"{value.ndim} dimensions"))
            sigmas.append(value)
        q_0, root, parts = standardised(fit, is_force)
        n_out = fit.modes.outputs.shape[1]
        given = found.frequencies, found.damping_ratios, shapes, pt.stack(sigmas), q_0, root, parts, n_out
        rv = pm.CustomDist(
            name,
            *given,
            logp=lambda value, *given: TransferLogp()(*given, value)[0],
            random=drawn,
            signature=SIGNATURE,
            observed=np.zeros(len(root)),
        )
        warn_at_start(name, found, observed, fit)
        if observed.attrs.get("window") == "hann":
            warn_of_segments(fit, observed.attrs["duration"])
        chi2 = (
            fit.chi2 * float(observed["variance"].attrs.get("factor", 1.0)) if "variance" in observed else 1.0
        )
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
    if len(f) < 2 or not np.isfinite(h).all() or not (np.diff(f) > 0.0).all() or f[0] <= 0.0:
        advice = "Choose a band by .sel(frequency=slice(low, high)), and leave out lines without a value."
        raise ValueError(message("observed", "finite, at ascending frequencies above zero", shown(h), advice))
    variance = [None] * h.shape[1]
    if "variance" in observed:
        variance = observed["variance"].transpose(*DIMS).values
        wrong = np.argwhere(~(np.isfinite(variance) & (variance > 0.0)))
        if len(wrong):
            reference, response = (observed[dim].values[i] for dim, i in zip(DIMS, wrong[0], strict=False))
            got = f"another one of response {response!r} to {reference!r}"
            raise ValueError(message("variance", "positive at all lines", got, "Leave dead channels out."))
    if (quantity := attrs.get("quantity", "accelerance")) not in POWERS:
        raise ValueError(message("quantity", f"one of {', '.join(POWERS)}", shown(quantity)))
    numbers = {key: check_number(attrs[key], key) for key in ("decay", "duration", "dt") if key in attrs}
    lines = Lines(f, POWERS[quantity], **numbers)
    blows = observed["blow"].values if "blow" in observed else [attrs.get("blow", np.nan)] * h.shape[1]
    unit = np.ones((1, len(f)))
    experiments = [
        Experiment(np.array([r]), unit, h[:, r], variance[r], blow=float(blow))
        for r, blow in enumerate(blows)
    ]
    fit = fit_modes(experiments, lines, gain=GAIN)
    if not len(fit.modes.natural):
        advice = "Choose a band with peaks, by .sel(frequency=slice(low, high))."
        raise ValueError(message("observed", "lines with modes", "none with any", advice))
    return MeasuredModes(observed, fit, lines)


def placed(structure, labels, given, name: str) -> tuple[list[int], np.ndarray]:
    """Degrees of freedom of channels, and -1 for one that is measured in the opposite direction."""
    labels = [str(label) for label in labels]
    wanted = labels if given is None else as_list(given)
    if wanted is None or len(wanted) != len(labels):
        raise ValueError(message(name, f"one for each of the {len(labels)} channels", shown(given)))
    places, signs = [], []
    known = structure.dof_names or ()
    if given is None and not known:
        raise ValueError(message(name, "given for a structure whose degrees of freedom have no names", given))
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


def standardised(fit: TransferFit, is_force: bool):
    """q_0 (n, k), the root R (d, n k) of the information, and R S R' of each part of the model's error."""
    n, n_in = fit.modes.inputs.shape
    k, information = fit.modes.table.shape[1], fit.information
    order = np.r_[0, 1, 2 + n_in : k, 2 : 2 + n_in] if is_force else np.r_[0, 1, 2 + n_in : k]
    kept = (np.arange(n)[:, None] * k + order).ravel()
    rest = np.setdiff1d(np.arange(n * k), kept)
    information = information[np.ix_(both := np.r_[kept, rest], both)]
    if rest.size:
        _, information = without_rest(np.zeros(n * k), information, kept.size)
    q_0, (values, vectors, scale) = fit.modes.table[:, order], known_directions(information)
    root = (vectors * np.sqrt(values)).T * scale
    n_out = fit.modes.outputs.shape[1]
    sizes = np.concatenate(
        [
            np.repeat(np.sqrt(np.mean(x**2, axis=1))[:, None], x.shape[1], axis=1)
            for x in np.split(q_0[:, 2:], [n_out], 1)
            if x.shape[1]
        ],
        axis=1,
    )
    along = root.reshape(len(root), n, -1)
    of_f = CORRELATION + (1.0 - CORRELATION) * np.eye(n)
    of_shapes = (along[:, :, 2:] * sizes).reshape(len(root), -1)
    parts = (
        along[:, :, 0] @ of_f @ along[:, :, 0].T,
        along[:, :, 1] @ along[:, :, 1].T,
        of_shapes @ of_shapes.T,
    )
    return q_0, root, np.array(parts)


class Misfit(NamedTuple):
    """What the log-likelihoods of particles (b,) are made of."""

    match: np.ndarray  # number of the mode of the model that each measured one is taken for (b, n)
    scaled: list[np.ndarray]  # shapes of these, in the scale of the measured ones (b, n, s) each
    factors: list[np.ndarray]  # by which they were multiplied (b, n, 1) each
    z: np.ndarray  # R (q - q_0) (b, d)
    covariance: np.ndarray  # (b, d, d)


def drawn(*given, rng=None, size=None) -> np.ndarray:
    """Draws (size, d) of the misfit, of the errors of the model and of the lines together."""
    *of_model, q_0, root, parts, n_out = given
    m = misfit_of(*(x[None] for x in of_model), q_0, root, parts, n_out)
    return rng.multivariate_normal(m.z[0], m.covariance[0], size=size, method="cholesky")


def misfit_of(frequencies, ratios, shapes, sigmas, q_0, root, parts, n_out) -> Misfit:
    """Match modes (b, m) with the measured ones, and compare them."""
    k, n_out = q_0.shape[1], int(n_out)
    ends = [2, 2 + n_out, *([k] if k > 2 + n_out else [])]
    measured = [q_0[:, first:last] for first, last in itertools.pairwise(ends)]
    own = np.split(shapes, [n_out], axis=-1)[: len(measured)]
    with np.errstate(all="ignore"):
        ln_w, ln_z = np.log(2.0 * np.pi * frequencies), np.log(ratios)
        score = -0.5 * ((q_0[:, :1] - ln_w[:, None]) / np.maximum(sigmas[:, 0], CLOSE)[:, None, None]) ** 2
        for x, y in zip(own, measured, strict=True):
            products = (x @ y.T).swapaxes(1, 2) ** 2
            mac = products / (np.sum(x**2, axis=2)[:, None] * np.sum(y**2, axis=1)[:, None])
            score -= 0.5 * (1.0 - mac) / np.maximum(sigmas[:, 2], ALIKE)[:, None, None] ** 2
    match = Assignment().run([score])[0].argmax(axis=-1)
    own = [np.take_along_axis(x, match[..., None], axis=1) for x in own]
    with np.errstate(all="ignore"):
        size = [np.sqrt(np.mean(x**2, axis=2, keepdims=True)) for x in own]
        aim = [np.sqrt(np.mean(y**2, axis=1, keepdims=True)) for y in measured]
        if len(own) == 1:
            factors = [aim[0] / size[0]]
        else:  # the product of both is what was measured
            ratio = np.sqrt(size[1] * aim[0] / (size[0] * aim[1]))
            factors = [ratio, 1.0 / ratio]
        sense = sum(
            np.sum(x * f * y, axis=2, keepdims=True) for x, f, y in zip(own, factors, measured, strict=True)
        )
    factors = [np.where(sense < 0.0, -f, f) for f in factors]
    scaled = [x * f for x, f in zip(own, factors, strict=True)]
    logs = [np.take_along_axis(x, match, axis=1)[..., None] for x in (ln_w, ln_z)]
    off = np.concatenate([*logs, *scaled], axis=2) - q_0
    with np.errstate(all="ignore"):  # what is not finite has no likelihood
        z = off.reshape(len(off), -1) @ root.T
        covariance = np.eye(len(root)) + np.tensordot(sigmas**2, parts, 1)
    return Misfit(match, scaled, factors, z, covariance)


class TransferLogp(RowOp):
    """Log-likelihood of the measured modes, and its gradient by what the model gives.

    Inputs are frequencies (m,) [Hz], damping ratios (m,) and shapes (m, s) of the model, the errors (3,) of
    ln f, ln zeta and shapes; and as constants q_0, R and R S R' of `standardised`, the number of
    responses, and the data (d,), zero.
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
    frequencies, ratios, shapes, sigmas, q_0, root, parts, n_out, value
) -> tuple[np.ndarray, ...]:
    """Log-likelihoods (b,), and gradients by the first four arguments; -inf and zero where there is none."""
    m = misfit_of(frequencies, ratios, shapes, sigmas, q_0, root, parts, n_out)
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
    rows = np.flatnonzero(good)[:, None]
    slopes[0][rows, match] = of_q[..., 0] / np.take_along_axis(frequencies[good], match, axis=1)
    slopes[1][rows, match] = of_q[..., 1] / np.take_along_axis(ratios[good], match, axis=1)
    # factors change with the sizes of shapes: of both by their ratio, of one against itself
    scaled, first = [x[good] for x in m.scaled], 2
    of_scaled, along = [], []
    for x in scaled:
        of_scaled.append(of_q[..., first : first + x.shape[2]])
        along.append(np.sum(of_scaled[-1] * x, axis=2, keepdims=True))
        first += x.shape[2]
    change = [along[0]] if len(scaled) == 1 else [0.5 * (along[0] - along[1]), 0.5 * (along[1] - along[0])]
    of_shapes = [
        (g - c * x / np.sum(x**2, axis=2, keepdims=True)) * f[good]
        for g, c, x, f in zip(of_scaled, change, scaled, m.factors, strict=True)
    ]
    both = np.concatenate(of_shapes, axis=2)
    slopes[2][rows, match, : both.shape[2]] = both
    return logp, *slopes


def warn_at_start(name, found, observed, fit: TransferFit) -> None:
    """Name peaks without a mode, and modes without a peak, at the start of a model; refuse undamped modes."""
    if (values := cheap_values_at_start([found.frequencies, found.damping_ratios])) is None:
        return
    f, ratios = values
    if not (ratios[f > 0.0] > 0.0).all():
        got = f"ratios of {ratios[f > 0.0].min():.3g}"
        raise ValueError(message("structure", "damped in all modes but those of a rigid body", got))
    if (f > 0.0).sum() < len(fit.modes.natural):
        got = f"{len(f)}, {(f == 0.0).sum()} of them of a rigid body"
        raise ValueError(
            message("n_modes", f"more than {len(fit.modes.natural)}, those that were measured", got)
        )
    low, high = observed["frequency"].values[[0, -1]]
    inside, peaks = f[(f > low) & (f < high)], fit.modes.natural / (2.0 * np.pi)
    if len(inside) != len(peaks):
        few, many = ("peak", "modes") if len(peaks) < len(inside) else ("mode", "peaks")
        seen, own = (", ".join(f"{x:.4g}" for x in some) or "none" for some in (peaks, inside))
        tell(
            f"{name} shows {len(peaks)} modes between {low:.4g} and {high:.4g} Hz, at {seen} Hz, and the "
            f"model has {len(inside)} there at its initial point, at {own} Hz: some {many} have no {few}. "
            "Choose another band, by .sel(frequency=slice(low, high)), or the start of the parameters."
        )


def tell(text: str) -> None:
    """Warn of modes that do not fit together, at the user's line."""
    warn_caller(text, ModalMatchWarning)


def warn_of_segments(fit: TransferFit, duration: float) -> None:
    """Name the mode whose peak is widened most, where segments of averages are short for its damping."""
    counts = fit.modes.ratios * fit.modes.natural / np.pi * duration
    if counts.min() < IN_PEAK:
        f = fit.modes.natural[counts.argmin()] / (2.0 * np.pi)
        tell(
            f"Hann segments of {duration:.4g} s are short for the damping of the mode at {f:.4g} Hz, which "
            f"will look larger: {counts.min():.2g} lines lie in its half-power width. Take segments of "
            f"{duration * IN_PEAK / counts.min():.2g} s and more."
        )
