"""Fig. 1: the ground acceleration."""

import matplotlib.pyplot as plt
import numpy as np


def plot_record(result, ax=None):
    """Ground acceleration of a study against time.

    Parameters
    ----------
    result : DataTree
        From `sampling_rate_study`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib Axes
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(7.0, 2.6), layout="constrained")
    data = result["data"].to_dataset()
    acceleration = data["ground_acceleration"]
    peak = int(np.abs(acceleration.values).argmax())
    time, value = float(data["record_time"][peak]), float(acceleration[peak])
    ax.plot(data["record_time"], acceleration, color="0.25", lw=0.7)
    ax.plot(time, value, "o", color="C3", ms=5, label=f"peak {abs(value):.3g} m/s²")
    ax.axhline(0.0, color="0.8", lw=0.6, zorder=0)
    ax.set(
        xlabel="time [s]",
        ylabel="ground acceleration [m/s²]",
        xlim=(0.0, float(data["record_time"][-1])),
        title=data.attrs.get("record", ""),
    )
    ax.legend(frameon=False, loc="upper right")
    return ax
