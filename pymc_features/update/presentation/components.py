"""Responses of draws by their principal components: a page shows any of them without holding all."""

import numpy as np
import xarray as xr

from pymc_features.prediction.draws import structure_draws

HISTORIES = 200  # draws whose responses are kept
COMPONENTS, HELD = 6, 0.999  # at most so many, or as many as hold this share of their variance


def components_of(blocks, median, labels) -> xr.Dataset:
    """Responses of some draws, less their median, by principal components.

    The deviations D (sensor and time, draw) have the Gram matrix D'D = V diag(s^2) V'; the components are
    U = D V with the largest s, and a draw is the median plus U times its row of V.

    Parameters
    ----------
    blocks : callable
        () to pairs of a first sample and the deviations from there on (sensor, time, draw).
    median : DataArray (sensor, time)
        What they deviate from.
    labels : dict
        `chain` and `draw` of each sample.

    Returns
    -------
    Dataset
        `component` (component, sensor, time), `coefficient` (sample, component), with `chain` and `draw` of
        each sample, and the share of the variance that is held in `attrs`.
    """
    gram = sum(np.einsum("rta,rtb->ab", d, d) for _, d in blocks())
    squares, vectors = np.linalg.eigh(gram)
    squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
    total = squares.sum()
    share = np.cumsum(squares) / total if total > 0.0 else np.ones(len(squares))
    n = min(int(np.searchsorted(share, HELD)) + 1, COMPONENTS, len(squares))
    component = np.zeros((n, *median.shape), np.float32)
    for first, block in blocks():
        component[:, :, first : first + block.shape[1]] = np.einsum("rts,sc->crt", block, vectors[:, :n])
    return xr.Dataset(
        {
            "component": (("component", *median.dims), component),
            "coefficient": (("sample", "component"), vectors[:, :n]),
        },
        {"sensor": median["sensor"], "time": median["time"], **labels},
        {"share": float(share[n - 1])},
    )


def components_of_draws(data, problem, part) -> xr.Dataset:
    """Take `components_of` the responses to the motion that was measured."""
    measured, name = data.measured, data.quantity
    median = part["bands"]["response"].sel(quantile=0.5, drop=True)
    settings = {"dt": measured.step, "n_modes": problem.structure.n_modes, "sensors": data.dofs}
    drawn = structure_draws(
        part["posterior"].to_dataset(),
        problem.structure,
        [measured.record],
        [name],
        HISTORIES,
        0,
        keep_histories=True,
        **settings,
    )
    with drawn as chosen:
        return components_of(lambda: deviations(chosen, name, measured, median), median, chosen.labels)


def deviations(chosen, name, measured, median):
    """Yield (first compared sample, responses less the median (sensor, time, draw)), block by block."""
    compared = np.arange(len(chosen.ensemble.times(0)))[measured.compared]
    for first, values in chosen.ensemble.blocks(0, name):
        inside = compared[(compared >= first) & (compared < first + values.shape[1])]
        if inside.size:
            start = int(inside[0] - compared[0])
            block = slice(start, start + inside.size)
            yield start, values[:, inside - first] - median.values[:, block, None]
