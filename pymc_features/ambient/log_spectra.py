"""Logarithms of the spectral densities of channels: measured ones, and those that a model expects."""

import numpy as np
import pytensor.tensor as pt
import xarray as xr
from numpy.typing import ArrayLike
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import check_integer, message, shown
from pymc_features.ambient.bands import checked_bands
from pymc_features.ambient.forces import in_bands, modal_factor
from pymc_features.ambient.spectral import MEASURED, SpectralResponse, spectral
from pymc_features.ambient.transfer import transfer_functions
from pymc_features.ambient.transforms import band_transform
from pymc_features.ops.gradient import undefined
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values

N = 5  # parameters: frequencies, damping ratios, shapes, factor of the forces, error
CORE = "(m),(m),(m,s),(b,m,r,p),(b,s),(c,a),(c),()"


def log_spectra(channels: xr.DataArray, bands: ArrayLike, *, average: int = 8) -> xr.DataArray:
    """Logarithms of the spectral densities of channels in some bands, a feature for TN and EXP.

    The power of `average` neighbouring frequencies is averaged, and the mean error of the logarithm of such
    an average, psi(m) - ln m, is taken off; its variance is psi'(m), 0.133 for eight.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them, without gaps.
    bands : array_like (band, 2)
        Lower and upper ends [Hz], apart from each other.
    average : int
        Frequencies m of the record that are averaged.

    Returns
    -------
    DataArray (sensor, frequency)
        ln S, S one-sided [unit^2/Hz], at the middle of each average [Hz], with the coordinate `band`. Pass it
        to `expected_log_spectra`, and its values as `observed`.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.
    """
    from scipy.special import digamma

    values = whole_values(channels)
    average, dt = check_integer(average, "average", least=1), sampling_step(channels)
    checked = checked_bands(bands, values.shape[1], dt, 0)
    cells, band = [], []
    for number, (first, last) in enumerate(zip(checked.starts[:-1], checked.starts[1:], strict=True)):
        own = checked.bins[first:last][checked.weights[first:last] > 0.0]
        if own.size < average:
            raise ValueError(message("average", f"at most the {own.size} frequencies of each band", average))
        cells.append(own[: own.size // average * average].reshape(-1, average))
        band += [number] * len(cells[-1])
    bins = np.concatenate(cells)
    parts = band_transform(values, bins.ravel(), np.ones(bins.size), dt)
    power = (parts**2).sum(axis=1).reshape(len(values), *bins.shape).mean(axis=-1)
    if not (power > 0.0).all():
        raise ValueError(message("channels", "channels that move in the bands", "one without any power"))
    duration = values.shape[1] * dt
    return xr.DataArray(
        np.log(power) - (digamma(average) - np.log(average)),
        {
            "sensor": channels["sensor"].values,
            "frequency": bins.mean(axis=1) / duration,
            "band": ("frequency", band),
        },
        ("sensor", "frequency"),
        name="log_spectra",
        attrs={"average": average, "duration": duration},
    )


def expected_log_spectra(
    response: SpectralResponse, error: TensorLike, measured: xr.DataArray
) -> TensorVariable:
    """What a structure under white forces makes of `log_spectra`: the mean `mu` of a likelihood.

    Parameters
    ----------
    response : SpectralResponse
        Of the structure, from `spectral_response`.
    error : tensor_like (), (band,) or (band, sensor)
        One-sided spectral density of the prediction error of each channel [unit^2/Hz]. Positive.
    measured : DataArray (sensor, frequency)
        From `log_spectra`.

    Returns
    -------
    TensorVariable (sensor, frequency)
        ln of the expected spectral densities, averaged over the same frequencies.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.
    """
    if not isinstance(response, SpectralResponse):
        raise TypeError(message("response", "what `spectral_response` returned", shown(response)))
    if not (isinstance(measured, xr.DataArray) and {"average", "duration"} <= set(measured.attrs)):
        raise TypeError(message("measured", "what `log_spectra` returned", shown(measured)))
    if (s := response.shapes.type.shape[1]) not in (None, measured.sizes["sensor"]):
        got = measured.sizes["sensor"]
        raise ValueError(message("measured", f"of the {s} sensors of the response", f"{got} of them"))
    band = measured["band"].values.astype(np.int64)
    b = int(band.max()) + 1
    density = in_bands(response.excitation, "excitation", b, response.patterns.type.shape[1], "force")
    error = in_bands(spectral(error, "error"), "error", b, measured.sizes["sensor"], "sensor")
    m, duration = measured.attrs["average"], measured.attrs["duration"]
    steps = (np.arange(m) - 0.5 * (m - 1)) / duration
    frequencies = measured["frequency"].values[:, None] + steps
    factor = modal_factor(response.patterns, density)
    integrals = np.int64(MEASURED[response.quantity])
    return LogSpectra()(*response[:3], factor, error, frequencies, band, integrals)


class LogSpectra(Op):
    """ln of the mean over a of S_s(f_ca), with S_s(f) = sum_r |sum_m phi_ms h_m(f) L_mr|^2 + S_e,s; (s, c).

    Of one particle. Inputs are frequencies, damping ratios and shapes of the modes, the factor of the forces,
    the spectral density of the error, frequencies (c, a) [Hz], the band of each c, and how often was
    integrated.
    """

    __props__ = ()
    gufunc_signature = f"{CORE}->(s,c)"

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        shape = inputs[4].type.shape[-1], inputs[5].type.shape[0]
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=shape)])

    def infer_shape(self, node, shapes):
        return [(shapes[4][1], shapes[5][0])]

    def perform(self, node, inputs, output_storage):
        [output_storage[0][0]] = self.run(inputs)

    def run(self, inputs) -> tuple[np.ndarray]:
        """The logarithms for arrays."""
        with np.errstate(all="ignore"):  # impossible modes give NaN
            *_, power = spectra_of(*inputs)
            return (np.log(power.mean(axis=-1)),)

    def connection_pattern(self, node):
        """Parameters count, frequencies do not."""
        return [[i < N] for i in range(len(node.inputs))]

    def pullback(self, inputs, outputs, cotangents):
        """By `LogSpectraGradient`."""
        slopes = LogSpectraGradient()(*inputs, *cotangents, return_list=True)
        return [*slopes, *(disconnected_type() for _ in inputs[N:])]


class LogSpectraGradient(Op):
    """Gradients by the five parameters, from the inputs of `LogSpectra` and the cotangent (s, c)."""

    __props__ = ()
    gufunc_signature = f"{CORE},(s,c)->(m),(m),(m,s),(b,m,r,p),(b,s)"

    def make_node(self, *inputs):
        inputs = [pt.as_tensor_variable(x) for x in inputs]
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=x.type.shape) for x in inputs[:N]])

    def infer_shape(self, node, shapes):
        return list(shapes[:N])

    def perform(self, node, inputs, output_storage):
        for storage, result in zip(output_storage, self.run(inputs), strict=True):
            storage[0] = result

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """Gradients for arrays.

        Of S = sum_r |R|^2 + S_e with R_skr = sum_m phi_ms h_km L_mr, the derivative is 2 Re conj(R) dR.
        """
        *parameters, cotangent = inputs
        natural, ratios, shapes, factor, error, frequencies, band, _ = parameters
        with np.errstate(all="ignore"):
            transfer, forces, roots, power = spectra_of(*parameters)
            weight = cotangent[..., None] / (power.mean(axis=-1, keepdims=True) * power.shape[-1])
            weight = np.broadcast_to(weight, power.shape).reshape(len(power), -1)
            rows = np.repeat(band, frequencies.shape[1])
            turned = 2.0 * weight[..., None] * roots.conj()
            by_force = np.einsum("skr,ms->kmr", turned, shapes)
            by_transfer = (by_force * forces[rows]).sum(axis=-1)
            of_shapes = np.einsum("skr,kmr->mks", turned, forces[rows])
            of_factor = np.zeros_like(factor)
            of_error = np.zeros_like(error)
            both = by_force * transfer[..., None]
            for number in range(len(error)):
                own = rows == number
                total = both[own].sum(axis=0)
                of_factor[number] = np.stack([total.real, -total.imag], axis=-1)
                of_error[number] = weight[:, own].sum(axis=1)
            f = frequencies.reshape(-1, 1)
            beta = natural / f
            scaled = by_transfer * transfer * transfer_functions(natural, ratios, f.ravel())
            return (
                (scaled * (2.0 * beta + 2j * ratios) / f).real.sum(axis=0),
                (scaled * 2j * beta).real.sum(axis=0),
                np.einsum("mks,km->ms", of_shapes, transfer).real,
                of_factor,
                of_error,
            )

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        return [*(undefined(self, inputs, i) for i in range(len(inputs)))]


def spectra_of(natural, ratios, shapes, factor, error, frequencies, band, integrals):
    """h (k, m), L (b, m, r), sum_m phi_ms h_km L_mr (s, k, r) and S (s, c, a), for k = c a frequencies."""
    f = frequencies.ravel()
    gains = (2.0 * np.pi * f[:, None]) ** -float(integrals)
    transfer = gains * transfer_functions(natural, ratios, f)
    forces = factor[..., 0] + 1j * factor[..., 1]
    rows = np.repeat(band, frequencies.shape[1])
    roots = (shapes.T @ (transfer[..., None] * forces[rows])).transpose(1, 0, 2)
    power = (np.abs(roots) ** 2).sum(axis=-1) + error[rows].T
    return transfer, forces, roots, power.reshape(len(power), *frequencies.shape)
