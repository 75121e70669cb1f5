"""How often 90 % intervals contain the truth, and how wide they are, by likelihood and kind of error.

Three stiffness factors and the damping of the source's ten-storey chain, all floors measured; and all ten.
The data are responses to a band-limited motion by a simulator of its own, `benchmarks.truth`.
"""

from benchmarks.coverage.ambient import run_ambient
from benchmarks.coverage.bounds import run_bounds
from benchmarks.coverage.cyclic import run_cyclic
from benchmarks.coverage.damping import run_damping
from benchmarks.coverage.errors import ERRORS
from benchmarks.coverage.events import run_events
from benchmarks.coverage.frequency_response import run_frequency_response
from benchmarks.coverage.identified import run_identified
from benchmarks.coverage.known_input import run_known_input
from benchmarks.coverage.model_errors import run_model_errors, run_records
from benchmarks.coverage.modes import run_modes
from benchmarks.coverage.steps import run_steps
from benchmarks.coverage.table import run_errors, run_ten

PARTS = {
    "errors": run_errors,
    "ten": run_ten,
    "events": run_events,
    "steps": run_steps,
    "identified": run_identified,
    "modes": run_modes,
    "damping": run_damping,
    "ambient": run_ambient,
    "bounds": run_bounds,
    "model errors": run_model_errors,
    "gaps and records": run_records,
    "cyclic": run_cyclic,
    "frequency response": run_frequency_response,
    "known input": run_known_input,
}
NAMES = (*PARTS, *ERRORS)


def run(quick=False, names=None, keep=None):
    """Print the tables, or those named; kinds of error may be named as well. `keep` is a file of events."""
    names = names or list(PARTS)
    kinds = [name for name in names if name in ERRORS]
    for name, part in PARTS.items():
        if name in names:
            part(quick, *([keep] if part is run_model_errors else []))
    if kinds:
        run_errors(quick, kinds)
