"""Examples of a configuration: each a function here, a template in `templates`, and a line in `EXAMPLES`.

The function takes the name of the file for simulated channels, and whether they must be simulated. It returns
the template of the configuration and what that takes, the text of the file with simulated channels, empty if
measured ones are used, and a sentence on which data are used, and why.
"""

import io
from pathlib import Path

import numpy as np

from pymc_features import datasets
from pymc_features.exceptions import DatasetUnavailableError
from pymc_features.ground_motion import synthetic_earthquake
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.storage import write_atomically
from pymc_features.structures import ModalDamping, SpringMassChain
from pymc_features.update.config.keys import SCHEMA
from pymc_features.update.templates import TEMPLATES

MASS = [4.2e5] * 7 + [3.4e5]  # kg
DRAWN = [9e8] * 3 + [7e8] * 3 + [5e8] * 2  # stiffness of the drawings [N/m]
STOREYS = {"lower": 3, "middle": 3, "upper": 2}  # that share a factor, from the base up
TRUE = {"lower": 0.8, "middle": 0.95, "upper": 1.1, "zeta": 0.03}
SENSORS = {"floor3": 2, "floor6": 5, "roof": 7}  # degrees of freedom
# m/s^2, and over the standard deviation of a floor, an error of the model in its place
BASE_NOISE, FLOOR_NOISE = 0.01, 0.05


def simulated(template, values, file, chain, record, sensors, random_seed, why):
    """An example with channels of a chain under a record, and white noise; `sensors` are names to places."""
    floors = simulate(chain, record, sensors=list(sensors.values())).values
    exact = np.vstack([record.acceleration, floors])
    scale = np.array([BASE_NOISE, *(FLOOR_NOISE * floors.std(axis=1))])[:, None]
    measured = exact + scale * np.random.default_rng(random_seed).standard_normal(exact.shape)
    header, table = ",".join(["time [s]", *(f"{name} [m/s^2]" for name in ("base", *sensors))]), io.StringIO()
    forms = ["%.2f", *["%.5f"] * len(measured)]
    np.savetxt(table, np.vstack([record.time, measured]).T, forms, ",", header=header, comments="")
    frequencies = ", ".join(f"{f:.3f}" for f in chain.modes().natural_frequencies[:3])
    values |= {"file": file, "frequencies": frequencies}
    return template, values, table.getvalue(), f"data: simulated, {why}"


def building(file: str, synthetic: bool):
    """A building of eight storeys with three sensors under El Centro 1940; there are only simulated data."""
    if synthetic:
        raise ValueError(
            "`--synthetic` must be left out for the example building, got it. Its data are always simulated."
        )
    drawn = datasets.el_centro()
    record = Record(drawn.acceleration, drawn.dt, drawn.name)  # band-limited, as the file will be read
    factors = np.repeat([TRUE[group] for group in STOREYS], list(STOREYS.values()))
    chain = SpringMassChain(MASS, DRAWN * factors, ModalDamping(TRUE["zeta"]))
    why = f"an eight-storey building under {record.name}, in {file}"
    values = {"record": record.name, "truth": TRUE, "base_noise": BASE_NOISE, "floor_noise": FLOOR_NOISE}
    return simulated("building.toml", values, file, chain, record, SENSORS, 8, why)


def shaking_table(file: str, synthetic: bool):
    """The three-storey model on a shaking table: measured data if they can be had, else simulated ones."""
    reason = "as asked"
    if not synthetic:
        try:
            datasets.mini_shake_table("northridge")
        except DatasetUnavailableError:
            synthetic, reason = True, "since the shaking table's could not be had here"
    if not synthetic:
        values = {"title": "Shaking table, three storeys", "scale": "2.0"}
        sentence = "data: measured, a three-storey model on a shaking table (northridge)"
        return "shaking_table.toml", values, "", sentence
    record = synthetic_earthquake(12.0, 0.01, random_seed=7, pga=3.0)
    chain = SpringMassChain([0.1601, 0.1601, 0.1421], [385.0, 420.0, 600.0], ModalDamping(0.01))
    values = {"synthetic": True, "title": "Simulated, three storeys", "scale": "0.5"}
    floors, why = {"floor1": 0, "floor2": 1, "floor3": 2}, f"in {file}, {reason}"
    return simulated("shaking_table.toml", values, file, chain, record, floors, 7, why)


EXAMPLES = {"shaking-table": shaking_table, "building": building}


def write_example(path, *, example: str = "shaking-table", synthetic: bool = False) -> tuple[list[Path], str]:
    """Write a commented configuration that runs as it is.

    Parameters
    ----------
    path : path
        Where; nothing there is overwritten.
    example : {"shaking-table", "building"}
        Three storeys with the measured data of a shaking table, if they can be had, else simulated ones; or
        a building of eight storeys with three sensors, simulated under El Centro 1940, whose true parameters
        the file states.
    synthetic : bool
        Do not look for the shaking table's data.

    Returns
    -------
    list of Path, str
        Files written, the configuration first, its JSON schema, by which editors check keys, last.
    str
        Which data they use, and why.

    Raises
    ------
    ValueError
        If there is no such example, or `synthetic` is asked of one whose data always are.
    FileExistsError, FileNotFoundError
        If a file is in the way, or the folder is missing.
    """
    path = Path(path)
    measured = path.with_name(f"{path.stem}-measured.csv")
    if example not in EXAMPLES:
        raise ValueError(f"`example` must be one of {', '.join(EXAMPLES)}, got {example!r}.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"`CONFIG` must be in an existing folder, got {path.parent}.")
    template, values, channels, sentence = EXAMPLES[example](measured.name, synthetic)
    schema = path.with_name(f"{path.stem}.schema.json")
    texts = {path: f"#:schema ./{schema.name}\n{TEMPLATES.get_template(template).render(values)}"}
    texts |= {measured: channels} if channels else {}
    if there := [file for file in texts if file.exists()]:
        raise FileExistsError(f"`CONFIG` must be a new file, got {there[0]}. Choose another name.")
    texts[schema] = SCHEMA.read_text(encoding="utf-8")  # which may be there, of another configuration
    for file, text in reversed(texts.items()):  # the configuration last, which names the other
        write_atomically(file, lambda p, text=text: p.write_text(text, encoding="utf-8"))
    return list(texts), sentence
