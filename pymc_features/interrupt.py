"""What Ctrl-C does to the command. Imported first of all, it imports little."""

import os
import signal
import sys
from typing import NoReturn

EXIT_INTERRUPTED = 130
SHOW_CURSOR = b"\x1b[?25h"  # which progress bars hide


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
