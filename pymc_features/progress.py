"""Progress of work in parts, which Ctrl-C stops."""

import signal
import sys
from time import monotonic

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from pymc_features.interrupt import CtrlC

WHOLE = 86_400.0  # s: the speed is estimated from all parts, of which some take much longer than others


class PartProgress:
    """A bar for the whole work above PyMC's bar for the part; plain lines where there is no terminal.

    Both say how long the rest will take, if parts take as long as they did so far.

    Ctrl-C is remembered: where Python drops the exception, as it does inside the callbacks by which Numba
    frees compiled code, the work stops before its next part.

    Parameters
    ----------
    console : rich.console.Console
    what : str
        What is done, at the beginning of the bar.
    pause : float
        Least time between two lines where there is no terminal [s].
    """

    def __init__(self, console, what, pause: float = 0.0):
        self.console, self.pause = console, pause
        self.begun, self.said = monotonic(), -float("inf")
        self.bar = Progress(
            TextColumn(f"[bold]{what}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=console,
            speed_estimate_period=WHOLE,
            disable=not console.is_terminal,
        )

    def __enter__(self):
        self.unraisable = sys.unraisablehook
        sys.unraisablehook = self._ignored
        self.handler = signal.getsignal(signal.SIGINT)
        self.ctrl_c = self.handler if isinstance(self.handler, CtrlC) else CtrlC(ends_process=False)
        if self.handler is signal.default_int_handler:
            signal.signal(signal.SIGINT, self.ctrl_c)
        self.bar.start()
        self.task = self.bar.add_task("")
        return self.update

    def __exit__(self, *error):
        self.bar.stop()
        sys.unraisablehook = self.unraisable
        if self.handler is signal.default_int_handler:
            signal.signal(signal.SIGINT, self.handler)

    def _ignored(self, unraisable):
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            self.unraisable(unraisable)

    def update(self, part, done, total):
        """Show that `part` is in work after `done` of `total`; stop if asked to."""
        if self.ctrl_c.pressed:
            raise KeyboardInterrupt
        self.bar.update(self.task, completed=done, total=total, description=part)
        now = monotonic()
        if self.console.is_terminal or now - self.said < self.pause:
            return
        self.said = now
        left = f", {remaining(now - self.begun, done, total)} left" if 0 < done < total else ""
        self.console.print(f"[{done}/{total}] {part}{left}", markup=False, highlight=False)


def remaining(elapsed: float, done: int, total: int) -> str:
    """Time for the parts that are left, as minutes and seconds, from that of those done [s]."""
    minutes, seconds = divmod(round(elapsed * (total - done) / done), 60)
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
