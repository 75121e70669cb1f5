"""AmbientResponse: the likelihood of responses to forces that nobody measured."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pymc.distributions.distribution import Continuous
from pytensor.tensor import TensorLike, TensorVariable

from pymc_features._checks import (
    as_numbers,
    check_finite,
    check_integer,
    check_name,
    check_step,
    message,
    shown,
)
from pymc_features.ambient.bands import checked_bands
from pymc_features.ambient.density import AmbientResponseRV
from pymc_features.ambient.forces import in_bands, modal_factor
from pymc_features.ambient.spectral import MEASURED, SpectralResponse, spectral
from pymc_features.ambient.warn import warn_at_start
from pymc_features.ops import as_tensor, by_labels, known_dims


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
        Of the structure, from `spectral_response`.
    error : tensor_like (), (band,) or (band, sensor)
        One-sided spectral density of the prediction error of each channel [unit^2/Hz]. Positive.
    bands : array_like (band, 2)
        Lower and upper ends of the bands [Hz], apart from each other.
    dt : float
        Sampling interval [s].
    observed : array_like (sensor, time)
        Measured channels, without gaps.
    mu : tensor_like (sensor, time), optional
        Known part of the response, for example `pmf.response` to a measured motion of the base: the forces
        that nobody measured act besides.
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
        mu: TensorLike | None = None,
        dims: Sequence[str] | None = None,
    ) -> TensorVariable:
        check_name(name)
        if not isinstance(response, SpectralResponse):
            raise TypeError(message("response", "what `spectral_response` returned", shown(response)))
        data = checked_channels(by_labels(observed, dims))
        if (s := response.shapes.type.shape[1]) not in (None, len(data)):
            advice = "Name the degrees of freedom of the channels by `sensors`."
            raise ValueError(message("observed", f"({s}, time), a row for each sensor", data.shape, advice))
        mean = np.zeros(data.shape) if mu is None else as_tensor(mu, "mu", "Pass what `response` returned.")
        settings = {"error": error, "bands": bands, "dt": dt, "n_samples": data.shape[1]}
        dims = known_dims(dims, 2)
        rv = super().__new__(cls, name, response, mu=mean, **settings, observed=data, dims=dims)
        warn_at_start(rv, response, checked_bands(bands, data.shape[1], dt, MEASURED[response.quantity]))
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
            raise TypeError(message("response", "what `spectral_response` returned", shown(response)))
        n_samples = check_integer(n_samples, "n_samples", least=1)
        bands = checked_bands(bands, n_samples, check_step(dt), MEASURED[response.quantity])
        s, b = response.shapes.type.shape[1], len(bands.limits)
        if s is None and mu is not None:
            s = np.shape(mu)[0] if not isinstance(mu, TensorVariable) else mu.type.shape[0]
        density = in_bands(response.excitation, "excitation", b, response.patterns.type.shape[1], "force")
        error = in_bands(spectral(error, "error"), "error", b, s, "sensor")
        if mu is None:
            mu = np.zeros((s, n_samples))
        mean = as_tensor(mu, "mu", "Pass what `response` returned.")
        wanted, shape = (s, n_samples), mean.type.shape
        if len(shape) != 2 or any(n not in (None, m) for n, m in zip(shape, wanted, strict=True)):
            raise ValueError(message("mu", f"of shape {wanted}", shape))
        factor = modal_factor(response.patterns, density)
        return super().dist([(*response[:3], factor, error, mean), bands], **kwargs)


def checked_channels(observed) -> np.ndarray:
    """Channels (sensor, time) of numbers."""
    data = as_numbers(observed, "observed", "Pass channels (sensor, time).").astype(np.float64)
    if data.ndim != 2 or not data.size:
        raise ValueError(message("observed", "channels (sensor, time)", data.shape))
    check_finite(data, "observed", "Cut the record where there are gaps, and pass the parts as variables.")
    return data
