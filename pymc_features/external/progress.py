"""How far many simulations are, in plain lines that do not disturb a progress bar."""

import sys
import time

SILENT_SECONDS = 5.0
EVERY_SECONDS = 10.0


class Lines:
    """Writes a line to standard error now and then: simulations done, failed, rate, time left.

    Parameters
    ----------
    shown : bool
        Or nothing is written.
    """

    def __init__(self, shown: bool):
        self.shown = shown
        self.last = None
        self.done = self.failed = 0
        self.seconds = 0.0  # of the batches before: what lies between them does not count in the rate
        self.batch_start = self.latest = 0.0

    def begin(self, total: int):
        """A batch of calls begins."""
        now = time.monotonic()
        if self.last is None:
            self.last = now + SILENT_SECONDS - EVERY_SECONDS
        self.seconds += self.latest - self.batch_start
        self.latest = now
        self.total, self.before, self.batch_start = total, self.done, now

    def count(self, ok: bool):
        """A call is over."""
        self.done += 1
        self.failed += not ok
        self.latest = time.monotonic()

    def tick(self):
        """Write a line if it is time to."""
        now = time.monotonic()
        if self.shown and now - self.last >= EVERY_SECONDS:
            self.last = now
            print(self.line(now), file=sys.stderr, flush=True)

    def line(self, now: float) -> str:
        """Text of the progress line."""
        done = self.done - self.before
        rate = self.done / max(self.seconds + now - self.batch_start, 1e-9)
        text = f"simulations: {self.done} done, {self.failed} failed, {rate:.3g}/s"
        if 0 < done < self.total:
            left = (now - self.batch_start) / done * (self.total - done)
            text += f"; of this batch {done} of {self.total}, {clock(left)} left"
        return text


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss or m:ss."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
