"""What a sequence of events says of the structure."""

import numpy as np

from pymc_features import plots

COLUMNS = (
    "event",
    "log score",
    "standard error",
    "of a structure unknown before",
    "probability of a change",
    "",
)
UNTOLD = 10.0  # standard error of a log score from which on its draws are too few to tell it
CANNOT_BE_TOLD = "cannot be told"
MEANING = (
    "Log score: ln of the density that the events before predicted for the measurements of this one; beside "
    "it the same of a structure of which only the priors are known. Where that is the larger one by far, the "
    "structure has changed before the event, or something was wrong with its measurement; the posterior is "
    "then that of this event and those after it. A score cannot be told where hardly any draw of the "
    "events before explains the event: increase `draws` in [sampler]."
)


def event_rows(part) -> list[tuple[str, ...]]:
    """Cells of each event under one likelihood, as of `COLUMNS`; none without a sequence."""
    if "sequence" not in part.children:
        return []
    record = part["sequence"].to_dataset()
    numbers = ("log_score", "log_score_se", "log_score_fresh")
    scores = np.array([[f"{value:.2f}" for value in record[name].values] for name in numbers], dtype=object)
    is_told = record["log_score_se"].values < UNTOLD
    scores[:2, ~is_told & np.isfinite(record["log_score"].values)] = CANNOT_BE_TOLD
    cells = [
        record["name"].values.astype(str),
        *scores,
        [f"{value:.3f}" for value in record["probability_changed"].values],
        ["alarm" if raised else "" for raised in record["alarm"].values],
    ]
    return list(zip(*cells, strict=True))


def events_verdict(kind, part) -> tuple[str, bool]:
    """Whether the structure has changed, in a sentence, and whether it has not; empty without a sequence."""
    if "sequence" not in part.children:
        return "", True
    record = part["sequence"].to_dataset()
    names, changed = record["name"].values, record["probability_changed"].values
    raised = np.flatnonzero(record["alarm"].values)
    last = f"What follows is the state after the last event, {names[-1]}."
    if raised.size:
        told = ", ".join(f"{names[k]} (probability {changed[k]:.3f})" for k in raised)
        return (
            f"Alarm: under {kind} the structure has changed before {told}; events before the last change "
            f"count no longer. {last}",
            False,
        )
    if names.size == 1:
        return f"One event, {names[0]}: there is nothing yet to compare it with.", True
    largest = int(changed.argmax())
    return (
        f"The {names.size} events are those of one structure under {kind}: the largest probability of a "
        f"change is {changed[largest]:.3f}, before {names[largest]}. {last}",
        True,
    )


def draw_events(part, units):
    """Parameters from event to event, with their units."""
    axes = plots.plot_sequence(part)
    for ax in axes:
        name = ax.get_ylabel()
        ax.set_ylabel(f"{name} [{units.get(name, '-')}]")
    return axes
