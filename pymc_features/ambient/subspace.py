"""Subspace identification by pyOMA2, which shares nothing with `identify_modes`: a second opinion.

A state-space model of order n has up to n/2 modes. Poles of modes stay where they are as the order rises,
others wander: a pole is stable where frequency, damping and shape are nearly those of the order before.

Pasca, D. P. and Margoni, D. F. (2024), pyOMA2, https://github.com/dagghe/pyOMA2. Reynders, E., Pintelon, R.
and De Roeck, G. (2008), Mech. Syst. Signal Process. 22, 948-969 (standard deviations).
"""

import logging
from collections.abc import Iterator
from contextlib import redirect_stderr
from importlib.util import find_spec
from io import StringIO

import numpy as np
import xarray as xr

from pymc_features._checks import check_integer, check_positive
from pymc_features.ambient.known_input import split_channels
from pymc_features.modal.data import ModalData, mac
from pymc_features.signals import sampling_step
from pymc_features.signals.channels import whole_values

HIGHEST_ORDER = 40
BLOCKS = 20, 60  # rows of the Hankel matrix in blocks, at least and at most
NEAR, ALIKE = 0.05, 0.8  # relative distance and MAC up to which a pole is of a mode


def is_installed() -> bool:
    """Whether pyOMA2 can be imported."""
    return find_spec("pyoma2") is not None


def subspace_poles(
    channels: xr.DataArray,
    excitation: xr.DataArray | str | list[str] | None = None,
    *,
    lowest: float | None = None,
    order: int = HIGHEST_ORDER,
) -> xr.Dataset:
    """Poles of channels by covariance-driven subspace identification of pyOMA2, which must be installed.

    Draw them with `plots.stabilisation`, beside modes of `identify_modes`.

    Parameters
    ----------
    channels : DataArray (sensor, time)
        As `read_channels` returns them, without gaps.
    excitation : DataArray (input, time), or names of channels, optional
        Forces, or motions of the base, that were measured; what else acts is white.
    lowest : float, optional
        Frequency of the lowest mode [Hz]: correlations are taken over half its period, and over 20 samples
        at least.
    order : int
        Highest order of the models; each mode takes two.

    Returns
    -------
    Dataset (pole, sensor)
        `order`, `frequency` and `frequency_sd` [Hz], `damping_ratio` and `damping_sd`, `is_stable` (pole);
        `shape` (pole, sensor), complex.

    Raises
    ------
    ImportError
        If pyOMA2 is not installed.
    ValueError, TypeError
        If an argument is out of range, or the excitation is no channel.
    """
    check_integer(order, "order", least=2)
    if lowest is not None:
        check_positive(lowest, "lowest")
    if not is_installed():
        raise ImportError("`subspace_poles` needs pyOMA2: pip install pyOMA_2.")
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    known = {"method": "cov"}
    if excitation is not None:
        channels, excitation = split_channels(channels, excitation)
        known = {"method": "IOcov", "U": whole_values(excitation).T}
    values, rate = whole_values(channels), 1.0 / sampling_step(channels)
    blocks = int(np.clip(np.ceil(0.5 * rate / (lowest or rate)), *BLOCKS))
    blocks = max(blocks, -(-order // len(values)) + 1)  # else there are more poles than equations
    logging.getLogger("pyoma2").setLevel(logging.WARNING)
    with redirect_stderr(StringIO()):  # bars of its own
        setup = SingleSetup((values - values.mean(axis=1, keepdims=True)).T, fs=rate)
        setup.add_algorithms(SSI(name="poles", br=blocks, ordmax=order, calc_unc=True, **known))
        setup.run_by_name("poles")
    found = setup.algorithms["poles"].result
    place = np.nonzero(np.isfinite(found.Fn_poles))
    poles = {
        "order": place[1],
        "frequency": found.Fn_poles[place],
        "frequency_sd": found.Fn_poles_std[place],
        "damping_ratio": found.Xi_poles[place],
        "damping_sd": found.Xi_poles_std[place],
        "is_stable": found.Lab[place] == 1,
    }
    shape = ("pole", "sensor"), found.Phi_poles[place]
    coords = {"sensor": channels["sensor"].values}
    return xr.Dataset(
        {name: ("pole", row) for name, row in poles.items()} | {"shape": shape},
        coords,
        {"highest_frequency": 0.5 * rate},
    )


def second_opinion(modes: ModalData, poles: xr.Dataset) -> xr.Dataset:
    """What stable poles say of each mode: medians over the orders at which one has its frequency and shape.

    Returns
    -------
    Dataset (mode)
        `frequency`, `frequency_sd` [Hz], `damping_ratio`, `damping_sd`; `z_frequency` and `z_damping`, the
        differences over what both standard deviations are together; `n_orders`. NaN where no pole is.
    """
    kept = poles.isel(pole=np.flatnonzero(poles["is_stable"] & np.isfinite(poles["frequency_sd"])))
    away = np.abs(kept["frequency"].values / modes.frequencies[:, None] - 1.0)
    is_of = away < NEAR
    if modes.shapes is not None:
        is_of &= mac(modes.shapes, kept["shape"].values) > ALIKE
    names = ["frequency", "frequency_sd", "damping_ratio", "damping_sd"]
    table = np.full((len(modes), len(names)), np.nan)
    for row, own in zip(table, is_of, strict=True):
        if own.any():
            row[:] = [np.median(kept[name].values[own]) for name in names]
    f, f_sd, zeta, zeta_sd = table.T
    scores = {
        "z_frequency": (f - modes.frequencies) / np.hypot(f_sd, modes.frequency_sd),
        "z_damping": (zeta - modes.damping_ratios) / np.hypot(zeta_sd, modes.damping_sd),
        "n_orders": is_of.sum(axis=1),
    }
    return xr.Dataset(
        {name: ("mode", x) for name, x in (dict(zip(names, table.T, strict=True)) | scores).items()}
    )


def opinion_on(modes: ModalData, channels: xr.DataArray, excitation=None) -> Iterator[str]:
    """A line for each mode, with both identifications."""
    try:
        poles = subspace_poles(channels, excitation, lowest=modes.frequencies.min())
    except (ValueError, IndexError) as error:  # a short record, say: the modes are no worse for it
        yield f"subspace identification (pyOMA2) was not possible: {error}"
        return
    opinion = second_opinion(modes, poles)
    for r, f in enumerate(modes.frequencies):
        other = {name: float(value) for name, value in opinion.isel(mode=r).items()}
        there = "has no stable pole near it"
        if other["n_orders"]:
            there = (
                f"has {other['frequency']:.4g} Hz (z {other['z_frequency']:+.1f}), "
                f"{100 * other['damping_ratio']:.2f} % (z {other['z_damping']:+.1f})"
            )
        here = f"mode {r + 1}: {f:.4g} Hz, damping {100 * modes.damping_ratios[r]:.2f} %"
        yield f"{here}; subspace identification (pyOMA2) {there}"
