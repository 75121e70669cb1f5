"""UNAM, the standard acceleration file of the Mexican networks: facts in Spanish above columns in gal.

Base Mexicana de Datos de Sismos Fuertes, Sociedad Mexicana de Ingenieria Sismica, archivo estandar de
aceleracion, version 2.0; the facts that are used stand by name in each file.
"""

from pathlib import Path

from pymc_features.io.header import check_peak, check_sections, column_width
from pymc_features.io.labelled import demand, labelled
from pymc_features.io.lines import Lines, to_count, to_number
from pymc_features.io.recording import Channel, Format, Opening, recorded

NAME = "UNAM"


def recognises(opening: Opening) -> bool:
    """The title stands below the address of the network."""
    return any("ARCHIVO ESTANDAR DE ACELERACION" in line.upper() for line in opening.lines[:30])


def read(path: Path) -> tuple[list[Channel], None]:
    """The channels of a file."""
    lines = Lines(path, NAME)
    facts = labelled(lines, "DATOS DE ACELERACION")
    directions = _listed(facts, "ORIENTACION C1-C6", "ORIENTACION C7-C12")
    counts = {to_count(t) for t in _listed(facts, "NUM. TOTAL DE MUESTRAS", "NUM. TOTAL DE MUESTRAS")}
    steps = {to_number(t) for t in _listed(facts, "INTERVALO DE MUESTREO")}
    if not directions or len(counts) != 1 or len(steps) != 1:
        raise lines.error(
            "the header must state orientations, one number of samples and one interval for all channels",
            f"{len(directions)} orientations, {len(counts)} numbers, {len(steps)} intervals",
        )
    n_times, dt = counts.pop(), steps.pop()
    check_sections(lines, {"the number of samples": n_times, "the interval": dt})
    _check_duration(lines, facts, n_times, dt)
    unit = demand(lines, facts, "UNIDADES DE LOS DATOS").split()[0]
    for _ in range(4):
        lines.take("four lines of titles above the values")
    width = column_width("(" + next((facts[key] for key in facts if key.startswith("FORMATO DATOS")), ""), 10)
    values = lines.fields(n_times * len(directions), width, "values").reshape(-1, len(directions))
    if (line := lines.peek()) is not None:
        raise lines.error(f"nothing may follow the {n_times} rows", repr(line.strip()[:60]))
    peaks = [to_number(text) for text in _listed(facts, "ACEL. MAX.(GAL)")]
    for name, column, peak in zip(directions, values.T, [*peaks, *[None] * len(directions)], strict=False):
        check_peak(lines, name, column, peak)
    return [Channel(name, column, unit, dt) for name, column in zip(directions, values.T, strict=True)], None


def _listed(facts: dict[str, str], *labels: str) -> list[str]:
    """What stands between the slashes behind labels that begin so, "/N00E/N90E/V"."""
    found = [facts[key] for key in facts if key.startswith(labels)]
    return [part.strip() for text in found for part in text.split("/") if part.strip()]


def _check_duration(lines: Lines, facts: dict[str, str], n_times: int, dt: float) -> None:
    """The duration must be that of the samples; a decimated file may state the step of the recorder."""
    for text in _listed(facts, "DURACION DEL REGISTRO"):
        duration = to_number(text)
        if duration is not None and abs(duration - n_times * dt) > 2.0 * dt + 0.01 * duration:
            raise lines.error(
                f"{n_times} samples at {dt:g} s must take the duration of the header",
                f"{duration:g} s",
            )


UNAM = Format(NAME, recognises, "day and number, .191", "step, units, directions, peaks", recorded(read))
