"""Results of `update` made by hand, with every group that the page of a report draws."""

import json

import numpy as np
import xarray as xr

from pymc_features.update.templates.numbers import Row


def large_result(kinds=("CAL", "NORM"), sensors=10, samples=10_000, seed=0) -> xr.DataTree:
    """White noise, which cannot be packed any smaller, at many sensors; six parameters, stages and events."""
    rng = np.random.default_rng(seed)
    names = [f"k{k}" for k in range(6)]
    time = 0.005 * np.arange(samples)
    labels = [f"floor {k}" for k in range(sensors)]
    observed = rng.standard_normal((sensors, samples))
    observed[0, 40:60] = np.nan  # a gap
    tree, rows = {}, []
    for kind in kinds:
        draws = {name: 2e7 * (1.0 + 0.05 * rng.standard_normal((2, 1000))) for name in names}
        for name, values in draws.items():
            quantiles = np.quantile(values, [0.05, 0.5, 0.95])
            rows.append(Row(kind, name, "N/m", *quantiles, values.mean(), values.std(), 0.9, 1.0, 1e3, 0.2))
        tree |= {f"/{kind}/{name}": group for name, group in part(rng, draws, observed, labels, time).items()}
    frequency = np.linspace(0.0, 100.0, 2000)
    data = {
        "ground_acceleration": ("record_time", rng.standard_normal(samples)),
        "gain": (("sensor", "frequency"), np.exp(rng.standard_normal((sensors, 2000)))),
        "peak_frequency": ("peak", [1.0, 3.0]),
    }
    tree["/data"] = xr.Dataset(data, {"record_time": time, "frequency": frequency}, {"record": "noise"})
    tree["/predict/stronger"] = predicted(rng, time)
    place = ("point", "axis")
    floors = {"place": (place, np.outer(np.arange(1.0, 13.0), [0.0, 0.0, 1.0]))}
    floors["direction"] = place, np.tile([1.0, 0.0, 0.0], (12, 1))
    shown = {"style": "storeys", "lines": "[[0, 11]]", "sensors": json.dumps({"floor 0": 0, "roof": 11})}
    tree["/geometry"] = xr.Dataset(floors, attrs=shown)
    result = xr.DataTree.from_dict(tree)
    result.attrs = {"document": json.dumps(document(rows)), "units": json.dumps(dict.fromkeys(names, "N/m"))}
    return result


def part(rng, draws, observed, labels, time) -> dict[str, xr.Dataset]:
    """The groups of one likelihood."""
    sensors, samples = observed.shape
    response = np.sort(rng.standard_normal((3, sensors, samples)), axis=0)
    of_draws, of_stages, at = ("chain", "draw"), ("chain", "stage"), {"sensor": labels, "time": time}
    bands, histories = ("quantile", *at), ("component", *at)
    shapes = np.sin(np.outer(2 * np.arange(5) + 1, np.arange(1, 13)) * np.pi / 25)
    frequencies = np.array([1.0, 3.0, 5.0, 7.0, 9.0])
    sampled = {"chain": ("sample", np.repeat([0, 1], 100))}
    sampled["draw"] = "sample", np.tile(np.arange(0, 1000, 10), 2)
    groups = {
        "posterior": {name: (of_draws, values) for name, values in draws.items()},
        "prior": {name: (of_draws, 2e7 * np.exp(rng.standard_normal((1, 4000)))) for name in draws},
        "observed_data": {"y": (tuple(at), observed, {"units": "m/s^2"})},
        "bands": {"response": (bands, response), "predictive": (bands, 2.0 * response)},
        "histories": {
            "component": (histories, rng.standard_normal((6, sensors, samples))),
            "coefficient": (("sample", "component"), 0.1 * rng.standard_normal((200, 6))),
        },
        "modal": {
            "natural_frequency": ((*of_draws, "mode"), frequencies * rng.normal(1.0, 0.01, (2, 250, 1)))
        },
        "mode_shapes": {
            "shape": (("sample", "mode", "point"), shapes * rng.normal(1.0, 0.05, (24, 1, 1))),
            "frequency": (("sample", "mode"), np.tile(frequencies, (24, 1))),
        },
        "sample_stats": {
            "beta": (of_stages, np.tile([0.0, 0.1, 1.0], (2, 1))),
            "accept_rate": (of_stages, np.full((2, 3), 0.4)),
        },
        "sequence": {
            "mean": (("event", "parameter"), 2e7 * np.ones((3, 2))),
            "standard_deviation": (("event", "parameter"), 1e5 * np.ones((3, 2))),
            "alarm": ("event", [0, 0, 1]),
        },
    }
    coords = {
        "posterior": {"chain": [0, 1], "draw": np.arange(1000)},
        **{"observed_data": at, "bands": at | {"quantile": [0.05, 0.5, 0.95]}, "histories": sampled},
        "sequence": {"parameter": ["k0", "k1"], "name": ("event", ["a", "b", "c"])},
    }
    found = {name: xr.Dataset(group, coords.get(name)) for name, group in groups.items()}
    found["histories"].attrs["share"] = 0.995
    return found


def predicted(rng, time) -> xr.Dataset:
    """Two responses to another motion: drifts of three storeys [m] with limits, and the base shear [N]."""
    quantiles = np.sort(rng.standard_normal((3, 3, time.size)), axis=0)
    peaks = rng.lognormal(np.log([0.01, 0.03, 0.02]), 0.2, (500, 3))
    limits, limit = np.array([0.02, 0.03, 0.05]), "inter_storey_drift_limit"
    found = {
        "inter_storey_drift": (("quantile", "storey", "time"), 0.01 * quantiles, {"units": "m"}),
        "inter_storey_drift_peak": (("sample", "storey"), peaks),
        "inter_storey_drift_probability_any": (limit, (peaks.max(axis=1) > limits[:, None]).mean(axis=1)),
        "inter_storey_drift_probability_any_se": (limit, [0.01, 0.02, 0.001]),
        "base_shear": (("quantile", "time"), 1e5 * quantiles[:, 0], {"units": "N"}),
        "base_shear_peak": ("sample", 1e5 * peaks[:, 0]),
    }
    return xr.Dataset(
        found, {"storey": [0, 1, 2], "time": time, limit: limits, "quantile": [0.05, 0.5, 0.95]}
    )


def document(rows) -> dict:
    """The words of a report."""
    table = {"name": "fit", "section": "response", "title": "Fit", "columns": ["sensor", "error"]}
    table |= {"rows": [["floor 0", "1.00"]], "note": "All of it is noise."}
    return {
        "title": "A <large> result",
        "subtitle": "Noise.",
        "verdict": {"explains": False, "sentences": ["This model does not explain the noise."]},
        "sentences": [],
        "warnings": ["CAL: a </script> in a warning does no harm."],
        "posterior": [row._asdict() for row in rows],
        "changed": "The data changed nothing.",
        "tables": [table],
        "configuration": 'title = "</script><script>throw 1</script>"',
        "versions": ["numpy 2"],
    }
