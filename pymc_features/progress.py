"""Progress of work in parts, which Ctrl-C stops."""

import signal
import sys

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pymc_features.interrupt import CtrlC


class PartProgress:
    """A bar for the whole work above PyMC's bar for the part; plain lines where there is no terminal.

    Ctrl-C is remembered: where Python drops the exception, as it does inside the callbacks by which Numba
    frees compiled code, the work stops before its next part.
    """

    def __init__(self, console, what):
        self.console = console
        self.bar = Progress(
            TextColumn(f"[bold]{what}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=console,
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
        if not self.console.is_terminal:
            self.console.print(f"[{done}/{total}] {part}", markup=False, highlight=False)
