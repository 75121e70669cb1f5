"""Results of pyOMA2, by the attributes that its documentation states; the library itself is not imported.

`Fn` (m,) [Hz], `Phi` (s, m), and where the algorithm gives them `Xi` (m,), `Fn_std`, `Xi_std` (m,) and
`Phi_std` (s, m). Those of merged set-ups are how much the set-ups scatter.

Pasca, D. P. and Margoni, D. F. (2024), pyOMA2, https://github.com/dagghe/pyOMA2.
"""

from collections.abc import Mapping

import numpy as np

from pymc_features.modal.data import listed
from pymc_features.modal.files.identified import Identified

PER_MODE = {"frequency_sd": "Fn_std", "damping": "Xi", "damping_sd": "Xi_std"}


def is_oma(source) -> bool:
    """Whether an object is a result, or has one or several."""
    return hasattr(source, "Fn") or hasattr(source, "result") or _holds_results(source)


def _holds_results(source) -> bool:
    return (
        isinstance(source, Mapping)
        and bool(source)
        and all(hasattr(value, "Fn") for value in source.values())
    )


def read_oma(source) -> Identified:
    """Modes of a result, of an algorithm that has one, or of merged set-ups."""
    result = source if hasattr(source, "Fn") or isinstance(source, Mapping) else source.result
    name = type(source).__name__
    if isinstance(result, Mapping):
        if len(result) != 1:
            raise ValueError(
                f"`source` must be one result, got {name} with {listed([repr(key) for key in result])}. Pass "
                "one, such as source.result[...]."
            )
        result = next(iter(result.values()))
    if getattr(result, "Fn", None) is None or getattr(result, "Phi", None) is None:
        raise ValueError(
            f"`source` must have picked modes, got {name} without frequencies or shapes. Call `mpe` of its "
            "set-up first."
        )
    frequencies = np.atleast_1d(np.asarray(result.Fn, dtype=np.float64))
    count = frequencies.size
    given = {ours: getattr(result, theirs, None) for ours, theirs in PER_MODE.items()}
    return Identified(
        name,
        frequencies,
        shapes=_matrix(result.Phi, "Phi", count, name),
        shape_sd=_matrix(getattr(result, "Phi_std", None), "Phi_std", count, name),
        **{
            ours: None if value is None else np.asarray(value, dtype=np.float64)
            for ours, value in given.items()
        },
    )


def _matrix(values, attribute: str, count: int, name: str) -> np.ndarray | None:
    """Entries (mode, channel) of a matrix (channel, mode)."""
    if values is None:
        return None
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != count:
        raise ValueError(
            f"`source` must have {attribute} of shape (channel, mode) for {count} modes, got {array.shape} "
            f"of {name}. Pick the modes again."
        )
    return array.T
