"""A building of eight storeys with three sensors under El Centro 1940, simulated."""

import numpy as np

from pymc_features import datasets
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.structures import ModalDamping, SpringMassChain
from pymc_features.update.examples.example import Example, channel_file, noisy

MASS = [4.2e5] * 7 + [3.4e5]  # kg
DRAWN = [9e8] * 3 + [7e8] * 3 + [5e8] * 2  # stiffness of the drawings [N/m]
STOREYS = {"lower": 3, "middle": 3, "upper": 2}  # that share a factor, from the base up
TRUE = {"lower": 0.8, "middle": 0.95, "upper": 1.1, "zeta": 0.03}
SENSORS = {"floor3": 2, "floor6": 5, "roof": 7}  # degrees of freedom
BASE_NOISE, FLOOR_NOISE = 0.01, 0.05  # m/s^2; over the standard deviation of a floor


def building(file: str, synthetic: bool) -> Example:
    """Simulated data in a file of this name; there are no others."""
    if synthetic:
        raise ValueError(
            "`--synthetic` must be left out for the example building, got it. Its data are always simulated."
        )
    drawn = datasets.el_centro()
    record = Record(drawn.acceleration, drawn.dt, drawn.name)  # band-limited, as the file will be read
    factors = np.repeat([TRUE[group] for group in STOREYS], list(STOREYS.values()))
    chain = SpringMassChain(MASS, DRAWN * factors, ModalDamping(TRUE["zeta"]))
    floors = simulate(chain, record, sensors=list(SENSORS.values())).values
    measured = noisy(record.acceleration, floors, BASE_NOISE, FLOOR_NOISE, random_seed=8)
    channels = dict(zip(["base", *SENSORS], measured, strict=True))
    frequencies = chain.modes().natural_frequencies[:3]
    values = {
        "file": file,
        "record": record.name,
        "truth": TRUE,
        "base_noise": BASE_NOISE,
        "floor_noise": FLOOR_NOISE,
        "frequencies": ", ".join(f"{f:.3f}" for f in frequencies),
    }
    sentence = f"data: simulated, an eight-storey building under {record.name}, in {file}"
    return Example("building.toml", values, channel_file(record.time, channels), sentence)
