"""Responses of many draws by few principal components."""

import numpy as np
import xarray as xr

COMPONENTS, HELD = 6, 0.999  # at most so many, or as many as hold this share of the variance


def principal_components(blocks, median, labels) -> xr.Dataset:
    """Responses of some draws, less their median, by principal components: a page shows any, and holds few.

    The deviations D (sensor and time, draw) have the Gram matrix D'D = V diag(s^2) V'; the components are
    U = D V with the largest s, and a draw is the median plus U times its row of V. The share of the variance
    that is held is in `attrs`.
    """

    def deviations():
        for first, values in blocks():
            part = slice(first, first + values.shape[1])
            yield part, values - median.values[:, part, None]

    gram = sum(np.einsum("rta,rtb->ab", d, d) for _, d in deviations())
    squares, vectors = np.linalg.eigh(gram)
    squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
    total = squares.sum()
    share = np.cumsum(squares) / total if total > 0.0 else np.ones(len(squares))
    n = min(int(np.searchsorted(share, HELD)) + 1, COMPONENTS, len(squares))
    component = np.zeros((n, *median.shape), np.float32)
    for part, d in deviations():
        component[:, :, part] = np.einsum("rts,sc->crt", d, vectors[:, :n])
    return xr.Dataset(
        {
            "component": (("component", *median.dims), component),
            "coefficient": (("sample", "component"), vectors[:, :n]),
        },
        {"sensor": median["sensor"], "time": median["time"], **labels},
        {"share": float(share[n - 1])},
    )
