"""Handle Ctrl-C and SIGTERM so that a long command can save its work before it ends."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from dynamictree.errors import Cancelled

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(Cancelled):
    """Raised when a signal (Ctrl-C or SIGTERM) asks the command to stop."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_status = 128 + number


@contextmanager
def stopping_on_signals() -> Iterator[Callable[[], None]]:
    """Yield a function that raises `Interrupted` once a signal has come; a second signal ends the process at once."""
    received: list[int] = []
    before = {number: signal.getsignal(number) for number in _SIGNALS}

    def remember(number: int, frame: FrameType | None) -> None:
        received.append(number)
        for each in _SIGNALS:
            signal.signal(each, signal.SIG_DFL)

    def check() -> None:
        if received:
            raise Interrupted(received[0])

    try:
        for number in _SIGNALS:
            signal.signal(number, remember)
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
