"""What Ctrl-C does to the command, progress of work in parts, and signs of life while nothing else is said.

Imported first of all by the command, it imports little.
"""

import os
import signal
import sys
import threading
from time import monotonic
from typing import NoReturn

EXIT_INTERRUPTED = 130
SHOW_CURSOR = b"\x1b[?25h"  # which progress bars hide
WHOLE = 86_400.0  # s: the speed is estimated from all parts, of which some take much longer than others
QUIET = 3.0  # seconds after which something is said


class CtrlC:
    """A handler of SIGINT: the first Ctrl-C raises KeyboardInterrupt, and is remembered.

    While the command starts, the first ends the process: nothing is lost, and an exception in the middle of
    an import might not come through, for extension modules make others of it.

    Parameters
    ----------
    ends_process : bool
        Whether the second ends the process at once, wherever the first has brought it.
    is_starting : bool
        Whether nothing is begun yet; until `started` is called.
    """

    def __init__(self, *, ends_process: bool, is_starting: bool = False):
        self.pressed, self.ends_process, self.process = False, ends_process, os.getpid()
        self.is_starting = is_starting

    def __call__(self, number, frame):
        if self.is_starting:
            self.end(b"Interrupted.\n")
        if self.pressed and self.ends_process:
            self.end(b"Interrupted again: ended at once; finished parts are kept.\n")
        self.pressed = True
        sys.unraisablehook = lambda unraisable: None  # objects that are left half made complain at their end
        raise KeyboardInterrupt

    def end(self, sentence: bytes) -> NoReturn:
        """End the process and those that it started; of these, forked, each ends itself without a word."""
        if os.getpid() == self.process:
            if "multiprocessing" in sys.modules and not self.is_starting:
                import multiprocessing

                for child in multiprocessing.active_children():
                    child.kill()
            cursor = SHOW_CURSOR if os.isatty(2) and not self.is_starting else b""
            os.write(2, cursor + sentence)
        os._exit(EXIT_INTERRUPTED)


def started() -> None:
    """Say that work begins, which the first Ctrl-C stops in good order."""
    handler = signal.getsignal(signal.SIGINT)
    if isinstance(handler, CtrlC):
        handler.is_starting = False


class Heartbeat:
    """While nothing else is said, a line every three seconds with what is done, and for how long.

    On a terminal there are none from the second work on, which has bars that move.

    Parameters
    ----------
    console : rich.console.Console
    doing : str
        What is in work at first.
    """

    def __init__(self, console, doing: str):
        self.console, self.over = console, threading.Event()
        self.doing, self.start, self.said = doing, monotonic(), monotonic()

    def now(self, doing: str, is_said: bool = True) -> None:
        """Say from now on that something else is in work; whether it was said already."""
        if self.console.is_terminal:
            self.over.set()
        self.doing, self.start = doing, monotonic()
        if is_said:
            self.heard()

    def heard(self) -> None:
        """Wait anew, for something was said."""
        self.said = monotonic()

    def __enter__(self):
        threading.Thread(target=self._beat, daemon=True).start()
        return self

    def __exit__(self, *error):
        self.over.set()

    def _beat(self):
        while not self.over.wait(max(0.1, self.said + QUIET - monotonic())):
            if monotonic() >= self.said + QUIET:
                self.heard()
                seconds = monotonic() - self.start
                self.console.print(f"{self.doing}, for {seconds:.0f} s", markup=False, highlight=False)


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
    alive : Heartbeat, optional
        Told what is in work, and by how much it is done.
    pause : float
        Least time between two lines where there is no terminal [s].
    """

    def __init__(self, console, what, alive: Heartbeat | None = None, pause: float = 0.0):
        from rich import progress

        self.console, self.alive, self.pause = console, alive, pause
        self.begun, self.said = monotonic(), -float("inf")
        self.bar = progress.Progress(
            f"[bold]{what}",
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TimeElapsedColumn(),
            "left",
            progress.TimeRemainingColumn(),
            "{task.description}",
            console=console,
            speed_estimate_period=WHOLE,
            disable=not console.is_terminal,
        )

    def __enter__(self):
        self.unraisable = sys.unraisablehook
        self.handler = signal.getsignal(signal.SIGINT)
        self.ctrl_c = self.handler if isinstance(self.handler, CtrlC) else CtrlC(ends_process=False)
        if self.handler is signal.default_int_handler:
            signal.signal(signal.SIGINT, self.ctrl_c)
        self.bar.start()
        self.task = self.bar.add_task("")
        return self.update

    def __exit__(self, *error):
        self.bar.stop()
        if not self.ctrl_c.ends_process:
            sys.unraisablehook = self.unraisable
        if self.handler is signal.default_int_handler:
            signal.signal(signal.SIGINT, self.handler)

    def update(self, part, done, total):
        """Show that `part` is in work after `done` of `total`; stop if asked to."""
        if self.ctrl_c.pressed:
            raise KeyboardInterrupt
        self.bar.update(self.task, completed=done, total=total, description=part)
        now = monotonic()
        left = f", {remaining(now - self.begun, done, total)} left" if 0 < done < total else ""
        told = f"[{done}/{total}] {part}{left}"
        is_said = not self.console.is_terminal and now - self.said >= self.pause
        if is_said:
            self.said = now
            self.console.print(told, markup=False, highlight=False)
        if self.alive is not None:
            self.alive.now(told, is_said)


def remaining(elapsed: float, done: int, total: int) -> str:
    """Time for the parts that are left, as minutes and seconds, from that of those done [s]."""
    minutes, seconds = divmod(round(elapsed * (total - done) / done), 60)
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
