"""Identified modes as files that other programs read: CSV, JSON, Universal Files."""

import json
import re
from os import PathLike

import numpy as np

from pymc_features._checks import check_path, message, require
from pymc_features.io.formats.libraries import AXES
from pymc_features.modal.data import ModalData

PLACE = re.compile(r"(\d+)([XYZ])")


def write_modal(modal: ModalData, path: str | PathLike) -> None:
    """Write identified modes to a file that `read_modal` reads back equal.

    Parameters
    ----------
    modal : ModalData
    path : str or path-like
        CSV (``.csv``, ``.txt``): a row for each mode, complex entries as ``0.3-0.1j``, empty cells for what
        was not measured. JSON (``.json``): named arrays. Universal File (``.uff``, ``.unv``): data sets 55,
        which have six digits, no standard deviations, and channels named by node and direction, as ``12Z``.

    Raises
    ------
    ValueError, TypeError
        If `modal` is none, the ending is another, or a name does not fit the format.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from pymc_features import read_modal
    >>> modal = ModalData([1.2, 3.5], [[0.6, 1.0], [1.0, -0.5]], ["floor 1", "roof"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_modal(modal, Path(folder) / "modes.csv")
    ...     again = read_modal(Path(folder) / "modes.csv")
    >>> (again.shapes == modal.shapes).all(), again.channels
    (np.True_, ('floor 1', 'roof'))
    """
    path = check_path(path)
    if not isinstance(modal, ModalData):
        raise TypeError(message("modal", "a ModalData", type(modal).__name__, "See `read_modal`."))
    writers = {".csv": _write_csv, ".txt": _write_csv, ".json": _write_json}
    writers |= {".uff": _write_universal, ".unv": _write_universal}
    what = message("path", f"a file ending in {', '.join(writers)}", path.name)
    require(path.suffix.lower() in writers, what)
    writers[path.suffix.lower()](modal, path)


def _per_mode(modal: ModalData) -> dict[str, np.ndarray]:
    """Names of quantities and their numbers (m,), as `read_modal` calls them."""
    found = {
        "frequency": modal.frequencies,
        "frequency_sd": modal.frequency_sd,
        "damping": modal.damping_ratios,
        "damping_sd": modal.damping_sd,
    }
    return {name: values for name, values in found.items() if values is not None}


def _write_csv(modal: ModalData, path) -> None:
    import pandas as pd  # slow to import

    columns = {} if modal.labels is None else {"mode": modal.labels}
    columns |= {f"{name} [Hz]" if name == "frequency" else name: v for name, v in _per_mode(modal).items()}
    for k, name in enumerate(modal.channels):
        columns[name] = modal.shapes[:, k]
        if modal.is_complex:
            columns[name] = [f"{x.real:.17g}{x.imag:+.17g}j" for x in columns[name]]
            columns[name] = np.where(np.isnan(modal.shapes[:, k]), None, columns[name])
        if modal.shape_sd is not None:
            columns[f"{name}_sd"] = modal.shape_sd[:, k]
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.17g", lineterminator="\n")


def _write_json(modal: ModalData, path) -> None:
    what = message("path", "a table (.csv) for modes with labels", path.name)
    require(modal.labels is None, what)
    arrays = _per_mode(modal)
    if modal.shapes is not None:
        arrays["shapes"] = modal.shapes.real.T
        if modal.is_complex:
            arrays["shapes_imaginary"] = modal.shapes.imag.T
        if modal.shape_sd is not None:
            arrays["shape_sd"] = modal.shape_sd.T
    found = {name: np.where(np.isnan(values), None, values).tolist() for name, values in arrays.items()}
    if modal.channels:
        found["channels"] = list(modal.channels)
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def _write_universal(modal: ModalData, path) -> None:
    """Data sets 55: translations of each node that was measured in a mode, zero where a direction was not."""
    places = [PLACE.fullmatch(name) for name in modal.channels]
    what = "with channels named by node and direction, as 12Z, for a Universal File"
    got = ", ".join(modal.channels) or "none"
    require(places and None not in places, message("modal", what, got, "Write CSV."))
    nodes, columns = np.unique([int(place[1]) for place in places], return_inverse=True)
    entries = np.full((len(modal), len(nodes), 3), np.nan, dtype=modal.shapes.dtype)
    entries[:, columns, [AXES.index(place[2]) for place in places]] = modal.shapes
    ratios = np.zeros(len(modal)) if modal.damping_ratios is None else np.nan_to_num(modal.damping_ratios)
    kind, values = (3, 5) if modal.is_complex else (2, 2)
    lines = []

    def add(form: str, *numbers) -> None:
        lines.append("".join(f"{number:{form}}" for number in numbers))

    rows = enumerate(zip(modal.frequencies, ratios, entries, strict=True), 1)
    for number, (frequency, damping, shape) in rows:
        root = 2.0 * np.pi * frequency * complex(-damping, np.sqrt(1.0 - damping**2))
        of_root = [root.real, root.imag, 0.0, 0.0, 0.0, 0.0]
        reals = of_root if modal.is_complex else [frequency, 1.0, damping, 0.0]
        lines += ["    -1", "    55", *["NONE"] * 5]
        add("10d", 1, kind, 2, 8, values, 3)
        add("10d", 2, len(reals), 0, number)
        add("13.5E", *reals)
        for node, row in zip(nodes, shape, strict=True):
            if not np.isnan(row).all():
                add("10d", node)
                add("13.5E", *np.nan_to_num(row).view(np.float64))
        lines.append("    -1")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
