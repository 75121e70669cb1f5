"""AmbientResponse: the likelihood of responses to forces that nobody measured, in the frequency domain.

`spectral_response` says what white forces make of a structure. The transforms of channels at the frequencies
of some bands are Gaussian; a draw is a history that has these transforms, and nothing else but the mean.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pymc.distributions.distribution import Continuous, SymbolicRandomVariable
from pymc.logprob.abstract import _logprob
from pymc.pytensorf import normalize_rng_param
from pytensor.graph.basic import Apply, Constant, Variable
from pytensor.tensor import TensorLike, TensorVariable
from scipy import sparse

from pymc_features._checks import (
    as_numbers,
    check_choice,
    check_finite,
    check_integer,
    check_name,
    check_step,
    message,
    require,
    shown,
    warn_caller,
)
from pymc_features.ambient.bands import (
    Bands,
    BandTransform,
    band_histories,
    checked_bands,
    transfer_functions,
)
from pymc_features.ambient.operations import ModalFactor, SpectralLogp
from pymc_features.exceptions import AmbientWarning
from pymc_features.modal import modes
from pymc_features.modal.structural_modes import picked_outputs
from pymc_features.ops import as_tensor, by_labels, known_dims
from pymc_features.ops.arrays import ArrayOp
from pymc_features.ops.declared import cheap_values_at_start, positive_tensor
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.ops.response import response as known_response
from pymc_features.records import Loading, Record
from pymc_features.structures import Structure

MEASURED = {"acceleration": 0, "velocity": 1, "displacement": 2}  # how often the acceleration is integrated
KNOWN = dict(
    zip(MEASURED, ("absolute_acceleration", "relative_velocity", "relative_displacement"), strict=True)
)
PARTS = "(m),(m),(m,s),(b,m,r,c),(b,s)"
LINES = "bins", "weights", "gains", "starts", "dt"  # of `Bands`
ADVICE = "Pass a spectral density."
tell = partial(warn_caller, category=AmbientWarning)
FEWEST_IN_PEAK = 4.0  # frequencies of the record in the half-power width of a mode


class SpectralResponse(NamedTuple):
    """Modes of a structure at the sensors, and the forces on them.

    Attributes
    ----------
    frequencies, damping_ratios : TensorVariable (mode,)
        f_r [Hz] and zeta_r [-].
    shapes : TensorVariable (mode, sensor)
        Mass-normalised [kg^(-1/2)].
    patterns : TensorVariable (mode, force)
        phi_r' w_i, what unit force i does to mode r.
    excitation : TensorVariable (), (band,) or (band, force)
        One-sided spectral density of the forces.
    quantity : str
        A key of `MEASURED`.
    known : callable
        From a record, or forces, to the response of the structure to these at the sensors (sensor, time).
    """

    frequencies: TensorVariable
    damping_ratios: TensorVariable
    shapes: TensorVariable
    patterns: TensorVariable
    excitation: TensorVariable
    quantity: str
    known: Callable[[Record | Loading], TensorVariable]


def spectral_response(
    structure: Structure,
    excitation: TensorLike | None,
    *,
    forces: str | ArrayLike = "dofs",
    sensors: Sequence[int] | Sequence[str] | None = None,
    outputs: ArrayLike | sparse.sparray | None = None,
    n_modes: int | None = None,
    quantity: str = "acceleration",
) -> SpectralResponse:
    """Response of a structure to independent forces that are known by their spectral densities only.

    Parameters
    ----------
    structure : Structure
        Its parameters may be random variables. Of a nonlinear chain the small motions count.
    excitation : tensor_like (), (band,) or (band, force)
        One-sided spectral density of each force [N^2/Hz], constant in each band of `AmbientResponse`.
        Positive. None if all that acts is known, see `excitation` of `AmbientResponse`.
    forces : {"dofs", "modes"} or array_like (n, force)
        Where they act: one on each degree of freedom; one on each mode, phi' f with the unit N^2/kg/Hz; or
        patterns along the structure, in columns.
    sensors : sequence of int or str, optional
        Degrees of freedom where was measured, 0 next to the base, or their names. All by default.
    outputs : array_like or sparse matrix (s, n), optional
        S, for measured combinations S x of degrees of freedom instead of `sensors`.
    n_modes : int, optional
        Modes that are taken into account, lowest first; all by default. Of a mode above the bands the
        quasi-static part counts still.
    quantity : {"acceleration", "velocity", "displacement"}
        What was measured.

    Returns
    -------
    SpectralResponse
        For `AmbientResponse`.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.
    """
    check_choice(quantity, "quantity", tuple(MEASURED))
    density = pt.zeros(()) if excitation is None else positive_tensor(excitation, "excitation", ADVICE)
    if excitation is None:  # one that acts nowhere
        forces = np.zeros((structure.n_dof, 1))
    if isinstance(forces, str) and check_choice(forces, "forces", ("dofs", "modes")) == "modes":
        found = modes(structure, n_modes, sensors=sensors, outputs=outputs)
        shapes, patterns = found.shapes, pt.eye(found.frequencies.type.shape[0])
    else:
        found = modes(structure, n_modes)
        patterns = found.shapes
        if not isinstance(forces, str):
            given, n = as_numbers(forces, "forces", 'Pass "dofs", "modes", or a matrix.'), structure.n_dof
            is_matrix, what = given.ndim == 2 and len(given) == n and given.size, "a row for each degree of"
            require(is_matrix, message("forces", f"({n}, force), {what} freedom", given.shape))
            check_finite(given, "forces")
            patterns = pt.dot(patterns, given)
        picked, combined = picked_outputs(structure, sensors, outputs)
        shapes = found.shapes[:, picked]
        if combined is not None:
            shapes = pt.dot(shapes, combined.T)
    known = partial(
        known_response,
        structure,
        sensors=sensors,
        outputs=outputs,
        n_modes=n_modes,
        quantity=KNOWN[quantity],
    )
    return SpectralResponse(
        found.frequencies, found.damping_ratios, shapes, patterns, density, quantity, known
    )


def in_bands(value: TensorVariable, name: str, n_bands: int, columns: int | None, what: str):
    """A tensor (b, columns) from one number, one for each band, or one for each band and column."""
    expected = f"one value, one for each of the {n_bands} bands, or (band, {what})"
    shape = value.type.shape
    fits = value.ndim < 3 and (not value.ndim or shape[0] in (None, 1, n_bands))
    require(fits, message(name, expected, shape))
    fits = value.ndim < 2 or columns is None or shape[1] in (None, 1, columns)
    require(fits, message(name, expected, shape, f"There are {columns} columns."))
    if value.ndim < 2:
        value = value[..., None]
    return pt.broadcast_to(value, (n_bands, columns))


def modal_factor(patterns: TensorVariable, density: TensorVariable) -> TensorVariable:
    """L (b, m, r, 2) with L L' = P diag(S) P', for patterns P (m, r) and spectral densities S (b, r).

    Of more forces than modes, L is the Cholesky factor (b, m, m).
    """
    m, r = patterns.type.shape
    if m is None or r is None or r <= m:
        factor = patterns[None] * pt.sqrt(density)[:, None, :]
    else:
        factor = ModalFactor()(patterns, density)
    return pt.stack([factor, pt.zeros_like(factor)], axis=-1)


class AmbientHistories(ArrayOp):
    """Histories (s, t) whose transforms in some bands have the covariance E_k, from standard normal numbers.

    Inputs are those of `AmbientResponseRV`, and normal numbers (2, k, r) of forces and (s, 2, k) of errors.
    """

    gufunc_signature = f"{PARTS},(s,t),(k),(k),(k),(e),(),(c,k,r),(s,c,k)->(s,t)"

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=inputs[5].type.shape)])

    def infer_shape(self, node, shapes):
        return [shapes[5]]

    def run(self, inputs) -> tuple[np.ndarray]:
        """Histories of arrays."""
        natural, ratios, shapes, factor, error, mean, bins, weights, gains, starts, dt, *normal = inputs
        of_forces, of_error = (np.sqrt(0.5) * x for x in normal)
        band = np.repeat(np.arange(len(starts) - 1), np.diff(starts))  # of each frequency
        frequencies = bins / (dt * mean.shape[-1])
        transfer = gains[:, None] * transfer_functions(natural, ratios, frequencies)
        factor, of_forces = factor[..., 0] + 1j * factor[..., 1], of_forces[0] + 1j * of_forces[1]
        forces = np.einsum("kmr,kr->km", factor[band], of_forces)
        response = ((transfer * forces) @ shapes).T
        spectra = np.stack([response.real, response.imag], axis=1)
        spectra += of_error * np.sqrt(error[band].T[:, None])
        return (mean + band_histories(spectra, bins, weights, dt, mean.shape[-1]) / dt,)


class AmbientResponseRV(SymbolicRandomVariable):
    """Channels (s, t) whose transforms in some bands are Gaussian; draws have nothing else but the mean."""

    name = "AmbientResponse"
    extended_signature = f"[rng],{PARTS},(s,t),(k),(k),(k),(e),()->[rng],(s,t)"
    _print_name = ("AmbientResponse", "\\operatorname{AmbientResponse}")

    @classmethod
    def rv_op(
        cls,
        parameters: Sequence[TensorLike],
        bands: Bands,
        *,
        rng: Variable | None = None,
        size: TensorVariable | None = None,
    ) -> TensorVariable:
        """Build draws from `SpectralParameters`, with the mean (s, t) in place of transforms, and `Bands`."""
        parameters = [pt.as_tensor_variable(x) for x in parameters]
        lines = [pt.as_tensor_variable(getattr(bands, name)) for name in LINES]
        rng = normalize_rng_param(rng)
        _, _, shapes, factor, *_ = parameters
        k = bands.bins.size
        next_rng, forces = pt.random.normal(size=(2, k, factor.shape[2]), rng=rng, return_next_rng=True)
        next_rng, errors = pt.random.normal(size=(shapes.shape[1], 2, k), rng=next_rng, return_next_rng=True)
        histories = AmbientHistories()(*parameters, *lines, forces, errors)
        return cls(inputs=[rng, *parameters, *lines], outputs=[next_rng, histories])(rng, *parameters, *lines)


def parameters_of(rv: TensorVariable) -> list[Variable]:
    """Frequencies, damping ratios, shapes, factor of the forces, error and mean of an `AmbientResponse`."""
    return rv.owner.inputs[1:7]


@_logprob.register(AmbientResponseRV)
def ambient_logprob(op, values, rng, *inputs, **kwargs):
    """Log-likelihood of the transforms in all bands."""
    [value] = values
    natural, ratios, shapes, factor, error, mean, bins, weights, gains, starts, dt = inputs
    spectra = BandTransform()(value - mean, bins, weights, dt, value.shape[-1])
    frequencies = bins / (dt * value.shape[-1])
    logp = SpectralLogp(of_spectra=not isinstance(mean, Constant))
    return logp(natural, ratios, shapes, factor, error, spectra, frequencies, weights, gains, starts)


run_in_python(AmbientHistories)


class AmbientResponse(Continuous):
    r"""Likelihood of the response to wind, traffic or micro-tremors, whose histories nobody measured.

    .. math::

        F_k = \sqrt{2 \Delta t / N} \sum_j \hat y_j e^{-2 \pi i j k / N} \sim \mathcal{CN}(0, E_k), \qquad
        E_k = \Phi H_k S H_k^* \Phi^T + \mathrm{diag}(S_e), \qquad
        h_{kr} = \frac{(2 \pi i f_k)^{-q}}{1 - (f_r / f_k)^2 - 2 i \zeta_r f_r / f_k}

    for the frequencies f_k of some bands. Only these are compared: offsets, drifts and modes outside say
    nothing. What counts is the width of the bands times the duration, not the number of samples.

    Parameters
    ----------
    name : str
        Of the variable.
    response : SpectralResponse
        Of the structure, from `ambient.spectral_response`.
    error : tensor_like (), (band,) or (band, sensor)
        One-sided spectral density of the prediction error of each channel [unit^2/Hz]. Positive.
    bands : array_like (band, 2)
        Lower and upper ends of the bands [Hz], apart from each other.
    dt : float
        Sampling interval [s].
    observed : array_like (sensor, time)
        Measured channels, without gaps.
    excitation : Record or Loading, optional
        What was measured of what acts: a motion of the base, or the forces of a shaker or hammer, in steps of
        `dt` and from rest. The forces that nobody measured act besides. The response is that of
        `pmf.response`: absolute accelerations, velocities and displacements relative to the base.
    mu : tensor_like (sensor, time), optional
        Known part of the response in place of an `excitation`.
    dims : tuple of str, optional
        Names of the two axes of the data.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range, or a band has fewer than eight frequencies of the record.

    Warns
    -----
    AmbientWarning
        If at the model's initial point a band has no mode, or the record is too short for the damping of one.

    Notes
    -----
    The transforms of different frequencies are independent for long records only: the error is of the order
    of 1 / (2 zeta f_r T) for a mode of frequency f_r and a record of T seconds.

    A draw is a history with these spectral densities, zero outside the bands. Several set-ups of sensors
    are several variables of one model; so are records of several days.

    References
    ----------
    K.-V. Yuen & L. S. Katafygiotis, Adv. Struct. Eng. 6 (2003) 81-95; S.-K. Au, Operational Modal Analysis,
    Springer 2017, ch. 10 and 12.
    """

    rv_type = AmbientResponseRV
    rv_op = AmbientResponseRV.rv_op

    def __new__(
        cls,
        name: str,
        response: SpectralResponse,
        *,
        error: TensorLike,
        bands: ArrayLike,
        dt: float,
        observed: ArrayLike,
        excitation: Record | Loading | None = None,
        mu: TensorLike | None = None,
        dims: Sequence[str] | None = None,
    ) -> TensorVariable:
        check_name(name)
        if not isinstance(response, SpectralResponse):
            raise TypeError(message("response", "what `ambient.spectral_response` returned", shown(response)))
        data = as_numbers(by_labels(observed, dims), "observed", "Pass channels (sensor, time).")
        require(data.ndim == 2 and data.size, message("observed", "channels (sensor, time)", data.shape))
        advice = "Cut the record where there are gaps, and pass the parts as variables."
        check_finite(data, "observed", advice)
        s, advice = response.shapes.type.shape[1], "Name the degrees of freedom of the channels by `sensors`."
        what = message("observed", f"({s}, time), a row for each sensor", data.shape, advice)
        require(s in (None, len(data)), what)
        if excitation is not None:
            mu = followed(response, excitation, mu, data.shape[1], dt)
        mean = np.zeros(data.shape) if mu is None else as_tensor(mu, "mu", "Pass what `response` returned.")
        settings = {"error": error, "bands": bands, "dt": dt, "n_samples": data.shape[1]}
        dims = known_dims(dims, 2)
        rv = super().__new__(cls, name, response, mu=mean, **settings, observed=data, dims=dims)
        bands = checked_bands(bands, data.shape[1], dt, MEASURED[response.quantity])
        warn_at_start(rv, response, bands, is_known=mu is not None)
        return rv

    @classmethod
    def dist(
        cls,
        response: SpectralResponse,
        *,
        error: TensorLike,
        bands: ArrayLike,
        dt: float,
        n_samples: int,
        mu: TensorLike | None = None,
        **kwargs,
    ) -> TensorVariable:
        """Histories (sensor, n_samples) as a random variable of no model; see the class for the arguments."""
        if not isinstance(response, SpectralResponse):
            raise TypeError(message("response", "what `ambient.spectral_response` returned", shown(response)))
        n_samples = check_integer(n_samples, "n_samples", least=1)
        bands = checked_bands(bands, n_samples, check_step(dt), MEASURED[response.quantity])
        s, b = response.shapes.type.shape[1], len(bands.limits)
        if s is None and mu is not None:
            s = np.shape(mu)[0] if not isinstance(mu, TensorVariable) else mu.type.shape[0]
        density = in_bands(response.excitation, "excitation", b, response.patterns.type.shape[1], "force")
        error = in_bands(positive_tensor(error, "error", ADVICE), "error", b, s, "sensor")
        if mu is None:
            mu = np.zeros((s, n_samples))
        mean = as_tensor(mu, "mu", "Pass what `response` returned.")
        wanted, shape = (s, n_samples), mean.type.shape
        fits = len(shape) == 2 and all(n in (None, m) for n, m in zip(shape, wanted, strict=True))
        require(fits, message("mu", f"of shape {wanted}", shape))
        factor = modal_factor(response.patterns, density)
        return super().dist([(*response[:3], factor, error, mean), bands], **kwargs)


def followed(response: SpectralResponse, excitation, mu, n: int, dt: float) -> TensorVariable:
    """Response (sensor, time) to an excitation of the length of the record."""
    require(mu is None, message("mu", "left out with `excitation`", "both"))
    if not isinstance(excitation, Record | Loading):
        raise TypeError(message("excitation", "a Record or a Loading", shown(excitation)))
    fits = excitation.n_times == n and abs(excitation.dt - check_step(dt)) <= 1e-6 * dt
    got, advice = f"{excitation.n_times} samples at {excitation.dt:.6g} s", "Cut or resample one of them"
    what = message(
        "excitation", f"{n} samples at {dt:.6g} s, as `observed`", got, f"{advice} (`Record.resampled`)."
    )
    require(fits, what)
    return response.known(excitation)


def warn_at_start(rv, response, bands, is_known: bool) -> None:
    """Warn where at the model's initial point a band has no mode, or a mode in a band a peak too narrow.

    The response to what is known is right in short records, too.
    """
    if (values := cheap_values_at_start([response.frequencies, response.damping_ratios])) is None:
        return
    frequencies, ratios = values
    duration = bands.n_samples * bands.dt
    for low, high in bands.limits:
        inside = (frequencies >= low) & (frequencies <= high)
        if not inside.any():
            near = frequencies[np.argmin(np.abs(np.log(frequencies / np.sqrt(low * high))))]
            tell(
                f"the band {low:g} to {high:g} Hz of {rv.name} has no mode at the model's initial point; the "
                f"nearest is at {near:.4g} Hz. Move the band, or the start of the parameters."
            )
        for f, zeta in zip(frequencies[inside], ratios[inside], strict=True) if not is_known else ():
            warn_of_peak(f"the mode of {rv.name} at {f:.4g} Hz", f, zeta, duration)


def warn_of_peak(what: str, f: float, zeta: float, duration: float) -> None:
    """Warn if a record of some seconds has few frequencies in the half-power width of a mode."""
    count = 2.0 * zeta * f * duration
    if count < FEWEST_IN_PEAK:
        tell(
            f"a record of {duration:.4g} s is short for {what} with {100.0 * zeta:.3g} % damping: "
            f"{count:.2g} of its frequencies lie in the half-power width. Its damping will be uncertain and "
            f"biased; {FEWEST_IN_PEAK / (2 * zeta * f):.3g} s and more are better."
        )
