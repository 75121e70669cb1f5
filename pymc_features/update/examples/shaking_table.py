"""The three-storey model on a shaking table: its measured data, or simulated ones."""

from pymc_features import datasets
from pymc_features.exceptions import DatasetUnavailableError
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.simulators import simulate
from pymc_features.structures import ModalDamping, SpringMassChain
from pymc_features.update.examples.example import Example, channel_file, noisy

TEMPLATE = "shaking_table.toml"


def shaking_table(file: str, synthetic: bool) -> Example:
    """Measured data if they can be had, else simulated ones in a file of this name."""
    reason = "as asked"
    if not synthetic:
        try:
            datasets.mini_shake_table("northridge")
        except DatasetUnavailableError:
            synthetic, reason = True, "since the shaking table's could not be had here"
    if not synthetic:
        values = {"title": "Shaking table, three storeys", "scale": "2.0"}
        sentence = "data: measured, a three-storey model on a shaking table (northridge)"
        return Example(TEMPLATE, values, "", sentence)
    record = synthetic_earthquake(12.0, 0.01, random_seed=7, pga=3.0)
    chain = SpringMassChain([0.1601, 0.1601, 0.1421], [385.0, 420.0, 600.0], ModalDamping(0.01))
    floors = simulate(chain, record).values
    measured = noisy(record.acceleration, floors, base_noise=0.01, floor_noise=0.05, random_seed=7)
    names = ["base", "floor1", "floor2", "floor3"]
    values = {
        "synthetic": True,
        "title": "Simulated, three storeys",
        "scale": "0.5",
        "file": file,
        "frequencies": ", ".join(f"{f:.3f}" for f in chain.modes().natural_frequencies),
    }
    channels = channel_file(record.time, dict(zip(names, measured, strict=True)))
    return Example(TEMPLATE, values, channels, f"data: simulated, in {file}, {reason}")
