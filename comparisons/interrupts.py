"""An interrupt ends a command in order whatever it is at, the loading of packages too."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["interrupts_heeded"]

# Where packages are loaded, this is among the frames.
LOADER = "<frozen importlib._bootstrap>"
# An interrupt that could not be heeded is sent again after so long,
AGAIN_S = 0.02
# and heeded whatever is at work after so long: a file that is loaded as a model may never end.
LONGEST_S = 5.0


@contextmanager
def interrupts_heeded() -> Iterator[None]:
    """Raise KeyboardInterrupt for an interrupt, and let none be lost.

    A package that is interrupted while it loads may take that for something else, and go on
    without a part of itself; a compiled library swallows what is raised in a function that it
    calls. So the interrupt waits until the package is loaded, and comes again where it was
    swallowed. Where somebody else has a say in interrupts, or in another thread, nothing is done.

    Raises
    ------
    KeyboardInterrupt
        At the end, where an interrupt still waits then.
    """
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    interrupts = _Interrupts()
    hook = sys.unraisablehook

    def heed_swallowed(swallowed: sys.UnraisableHookArgs) -> None:
        if not issubclass(swallowed.exc_type, KeyboardInterrupt):
            hook(swallowed)
        else:
            interrupts.send_again()

    signal.signal(signal.SIGINT, interrupts.take)
    sys.unraisablehook = heed_swallowed
    try:
        yield
        if interrupts.waits:
            raise KeyboardInterrupt
    finally:
        interrupts.forget()
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, signal.default_int_handler)


class _Interrupts:
    """Interrupts that came, and whether the last one still waits."""

    def __init__(self) -> None:
        self._first_s: float | None = None
        self.waits = False

    def take(self, _: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, now or as soon as it will be heard."""
        now_s = time.monotonic()
        self._first_s = now_s if self._first_s is None else self._first_s
        if _is_loading(frame) and now_s - self._first_s < LONGEST_S:
            self.send_again()
            return
        self.waits = False
        raise KeyboardInterrupt

    def send_again(self) -> None:
        """Let the interrupt come once more in a while."""
        self.waits = True
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, self._send)
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        else:
            _thread.interrupt_main()

    def _send(self, _: int, __: FrameType | None) -> None:
        # Whoever has a say in interrupts by now gets it.
        self.waits = False
        signal.raise_signal(signal.SIGINT)

    def forget(self) -> None:
        """Call off what was to come once more."""
        if self._first_s is not None and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)


def _is_loading(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == LOADER:
            return True
        frame = frame.f_back
    return False
