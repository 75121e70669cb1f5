"""GeoNet of New Zealand, V1A and V2A: three components, one below the other, in columns of eight.

Above each are sixteen lines of text, four of integers and six of reals. V1A holds uncorrected accelerations,
V2A corrected accelerations with velocities and displacements.

GNS Science, GeoNet strong-motion data, file formats of volumes 1 and 2,
https://www.geonet.org.nz/data/supplementary/strong_motion_file_formats.
"""

from pathlib import Path

from pymc_features.io.header import check_peak, check_sections, number_after
from pymc_features.io.lines import Lines, to_number
from pymc_features.io.recording import Channel, Format, Opening, recorded

NAME = "GeoNet"
POINTS = 33  # integers: of accelerations, then of velocities and displacements
STEP_1, STEP_2 = 24, 25  # reals, of volumes 1 and 2 [s]


def recognises(opening: Opening) -> bool:
    """The first line names the volume, the second the site."""
    second = opening.lines[1].lower() if len(opening.lines) > 1 else ""
    volume = opening.first.startswith(("uncorrected accelerogram", "corrected accelerogram"))
    return volume and second.startswith("site ")


def read(path: Path) -> tuple[list[Channel], None]:
    """The components of a file."""
    lines = Lines(path, NAME)
    channels = []
    while lines.peek() is not None:
        channels.append(_component(lines))
    return channels, None


def _component(lines: Lines) -> Channel:
    while not (first := lines.take("a component")).strip():
        pass
    text = [first, *(lines.take("16 lines of text") for _ in range(15))]
    if "corrected accelerogram" not in first.lower():
        raise lines.error("a component must begin with its volume", repr(first.strip()[:60]))
    integers = lines.fields(40, 8, "integers")
    reals = lines.fields(60, 8, "reals")
    raw = first.lower().startswith("uncorrected")
    n_times, dt = int(integers[POINTS]), float(reals[STEP_1 if raw else STEP_2])
    check_sections(lines, {"the number of points": n_times, "the step": dt})
    _check_text(lines, text, n_times, dt)
    values = lines.fields(n_times, 8, "accelerations")
    for n_others in integers[POINTS + 1 : POINTS + 3]:  # velocities, displacements
        lines.fields(max(int(n_others), 0), 8, "values")
    name = next(iter(text[12].partition("Component")[2].split()), "acceleration")
    check_peak(lines, name, values, number_after(text[13].replace("Peak", "peak"), "peak"))
    return Channel(name, 1e-3 * values, "m/s^2", dt)


def _check_text(lines: Lines, text: list[str], n_times: int, dt: float) -> None:
    """Number, step and unit in words must be those of the numbers."""
    said = number_after(text[9], "points")
    words = text[10].split()
    steps = [to_number(a) for a, b in zip(words, words[1:], strict=False) if b.lower() in ("s", "sec")]
    if said != n_times or not steps or steps[0] is None or abs(steps[0] - dt) > 0.01 * dt:
        raise lines.error(
            f"the header must state one number of points and one step, in numbers {n_times} and {dt:g} s",
            f"in words {text[9].strip()[:40]!r} and {text[10].strip()[:60]!r}",
        )
    if text[13].split()[3:4] != ["mm/s/s"] or number_after(text[10], "in units of") not in (None, 1.0):
        raise lines.error("accelerations must be in mm/s/s", repr(text[13].strip()[:60]))


GEONET = Format(NAME, recognises, ".V1A, .V2A", "step, mm/s^2, components, peak", recorded(read))
