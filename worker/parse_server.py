"""Server that reads uploads: `python -m worker.parse_server`, its control socket on stdin.

Loading Python and the readers' libraries takes ten times as long as reading a small tree. So they are loaded once, and
each upload is read by a fork, which drops what it does not need (`worker.parse`). The server itself sees no byte of an
upload: it receives a connection, and reports the exit code of the fork.
"""

import ctypes
import gc
import importlib
import os
import select
import signal
import socket
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NoReturn

from worker import parse

LIBRARIES = ("PIL.Image", "scipy.ndimage", "scipy.sparse.csgraph", "scipy.spatial")
"""Libraries that readers would otherwise import on demand."""

_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True, kw_only=True)
class _Server:
    control: socket.socket
    woken: socket.socket  # readable when a fork has ended
    forks: dict[int, socket.socket] = field(default_factory=dict)  # connections by process id

    def run(self) -> None:
        """Fork for each connection received from the control socket, until its other end is closed."""
        poll = select.poll()
        poll.register(self.control, select.POLLIN)
        poll.register(self.woken, select.POLLIN)
        while True:
            for descriptor, _ in poll.poll():
                if descriptor == self.control.fileno():
                    _, passed, _, _ = socket.recv_fds(self.control, 1, 1)
                    if not passed:
                        return
                    poll.register(self._fork(*passed), 0)  # 0: reports only that the client has closed the connection
                elif descriptor == self.woken.fileno():
                    self.woken.recv(4096)
                    for connection in self._ended():
                        with suppress(KeyError):  # the client has left
                            poll.unregister(connection)
                        connection.close()
                else:
                    poll.unregister(descriptor)
                    self.end(descriptor)

    def end(self, descriptor: int | None = None) -> None:
        """End the fork of a connection, or all forks, and the programs that they run."""
        for pid, connection in self.forks.items():
            if descriptor in (None, connection.fileno()):
                with suppress(ProcessLookupError):
                    os.killpg(pid, signal.SIGKILL)

    def _fork(self, connection: int) -> socket.socket:
        pid = os.fork()
        if not pid:
            _read_upload(connection)
        with suppress(PermissionError, ProcessLookupError):
            os.setpgid(pid, pid)  # sets the group before anyone can end it
        self.forks[pid] = socket.socket(fileno=connection)
        return self.forks[pid]

    def _ended(self) -> list[socket.socket]:
        ended = []
        for pid in list(self.forks):
            ended_pid, status = os.waitpid(pid, os.WNOHANG)
            if ended_pid:
                connection = self.forks.pop(pid)
                with suppress(OSError):  # the client has left
                    connection.send(b"\n%d" % os.waitstatus_to_exitcode(status), socket.MSG_DONTWAIT)
                ended.append(connection)
        return ended


def main() -> None:
    """Load the libraries, then serve until the control socket is closed."""
    woken, wake = socket.socketpair()
    wake.setblocking(False)
    signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    for name in LIBRARIES:
        importlib.import_module(name)
    gc.freeze()
    server = _Server(control=socket.socket(fileno=os.dup(0)), woken=woken)
    try:
        server.run()
    finally:
        server.end()


def _read_upload(connection: int) -> NoReturn:
    """In a fork: read the request of a connection, respond, and exit."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.setpgid(0, 0)
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        for source, target in ((connection, 0), (connection, 1), (os.open(os.devnull, os.O_WRONLY), 2)):
            os.dup2(source, target)
        os.closerange(3, os.sysconf("SC_OPEN_MAX"))
        parse.main()
        code = 0
    finally:  # the fork must not run the server's loop after an exception
        os._exit(code)


if __name__ == "__main__":
    main()
