"""Identified modes: Universal Files, tables, MATLAB, JSON, mappings and results of pyOMA2."""

import codecs
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

import h5py

from pymc_features._checks import check_file, check_flag, check_texts
from pymc_features.io.formats.libraries import UNIVERSAL
from pymc_features.io.formats.matlab import load_variables
from pymc_features.io.reading.recording import Opening
from pymc_features.modal.data import ModalData, demand
from pymc_features.modal.files.labelled import from_variables, is_oma, read_json_modes, read_oma, read_table
from pymc_features.modal.files.quantities import check_names, modal_data
from pymc_features.modal.files.universal import read_universal
from pymc_features.modal.files.write import write_modal

__all__ = ["read_modal", "write_modal"]


def read_modal(
    source: str | PathLike | Mapping | object,
    *,
    names: Mapping[str, str] | None = None,
    channels: Sequence[str] | Mapping[str, str | int] | None = None,
    real: bool = True,
) -> ModalData:
    """Read identified modes: frequencies, damping ratios, shapes, and their standard deviations.

    Parameters
    ----------
    source : path, mapping of arrays, or result of pyOMA2
        A Universal File (data sets 55 and 2414: all its modes, channels named by node and direction such as
        ``12Z``); a text table with a row for each mode; MATLAB (``.mat``, also v7.3) or JSON, or a mapping,
        with named arrays. Known by what is in it. Of pyOMA2 a result, or the algorithm or merged set-ups that
        have it.
    names : mapping of str to str, optional
        What the source calls a quantity, where it does not call it by its own name: "frequency" [Hz], "omega"
        [rad/s], "eigenvalue" (omega^2), "damping" (fraction of critical), "damping_percent"; each of these
        with "_sd" for its standard deviation; "shapes" (channel, mode), "shapes_imaginary", "shape_sd" and
        "channels" of arrays. Names may end in their unit, as ``frequency [Hz]`` or ``omega_rad_s``. All other
        columns of a table are channels, and ``roof_sd`` beside ``roof`` is the standard deviation of its
        entries.
    channels : sequence of str, or mapping of names to channels, optional
        Which channels, by their names, in this order; a mapping gives them new names, from names or numbers
        (from 0) in the source. Where the source has no names, a sequence names them all, and without it they
        are called ``channel 0`` and so on.
    real : bool
        True: complex shapes are turned by the phase that leaves the least imaginary part, and their real part
        is taken. False: they are kept.

    Returns
    -------
    ModalData
        Frequencies [Hz], in the order of the source.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If there is no such file or it cannot be opened.
    ValueError, TypeError
        If an argument is not admissible, or the source does not hold modes as it must; the message names the
        file, the line where there is one, and what to do.

    Warns
    -----
    ModalDataWarning
        If the entries of a complex shape are far from one phase (modal phase collinearity below 0.9), or
        numbers look like another unit.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "modes.csv"
    ...     _ = path.write_text("omega [rad/s],damping [%],roof\\n6.2832,1.2,1.0\\n18.85,0.9,-0.5\\n")
    ...     modal = read_modal(path)
    >>> modal, modal.frequencies.round(3), modal.damping_ratios
    (ModalData(2 modes from 1 to 3 Hz, 1 channel), array([1., 3.]), array([0.012, 0.009]))
    """
    asked, real = check_names(names), check_flag(real, "real")
    if channels is not None and not isinstance(channels, str | Mapping):
        channels = check_texts(channels, "channels", "a sequence of names, or a mapping of names to channels")
    if isinstance(source, str | PathLike):
        path = check_file(source, "source")
        return modal_data(path.name, _read_file(path, asked, channels), channels, real)
    if is_oma(source):
        _refuse_names(asked, "a result of pyOMA2")
        return modal_data(type(source).__name__, read_oma(source), channels, real)
    if isinstance(source, Mapping):
        return modal_data("`source`", from_variables(source, "`source`", asked), channels, real)
    what = "`source` must be a path, a mapping of arrays or a result of pyOMA2"
    raise TypeError(f"{what}, got {type(source).__name__}. Make a `modal.ModalData` of arrays.")


def _read_file(path: Path, names: dict[str, str], channels) -> dict:
    """The modes in a file, whose kind is known by its first bytes."""
    opening = Opening.of(path)
    if opening.suffix in (".mat", ".npz") or opening.head.startswith(b"MATLAB ") or h5py.is_hdf5(path):
        return from_variables(load_variables(path), path.name, names)
    if opening.begins(UNIVERSAL):
        _refuse_names(names, f"{path.name}, a Universal File")
        return read_universal(path)
    if opening.head.removeprefix(codecs.BOM_UTF8).lstrip()[:1] in (b"{", b"["):
        return read_json_modes(path, names)
    wanted = list(channels.values()) if isinstance(channels, Mapping) else channels
    by_name = isinstance(wanted, list) and all(isinstance(name, str) for name in wanted)
    return read_table(path, names, wanted if by_name else None)


def _refuse_names(names: dict[str, str], what: str) -> None:
    got = f"{', '.join(names)}: {what} says itself what its numbers are"
    demand(not names, "`names` must be left out", got, "Leave it out.")
