"""Audit log: who did what, when, as JSON lines in `state_dir/audit/audit.jsonl`, bounded by rotation.

API processes, the command line and other machines' processes each append to the log of their own state folder, one line
per event, in one write. Ids and names only: never a key, a secret or a file's content.
"""

import fcntl
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

FILES = 4
"""The log itself and three older ones."""


@dataclass(frozen=True, kw_only=True)
class AuditLog:
    """Appends events. Without `max_bytes` there is no log."""

    path: Path
    max_bytes: int  # of all files together
    clock: Callable[[], float] = time.time

    def write(self, action: str, *, actor: str, target: str = "", outcome: str = "done", **fields: object) -> None:
        """Append one event; what is wrong with the disk passes through."""
        if self.max_bytes == 0:
            return
        at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self.clock()))
        event = {"at": at, "actor": actor, "action": action, "target": target, "outcome": outcome} | fields
        line = json.dumps(event).encode() + b"\n"
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = os.open(self.path.with_suffix(".lock"), os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self._rotate(len(line))
            log = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            try:
                os.write(log, line)
            finally:
                os.close(log)
        finally:
            os.close(lock)

    def _rotate(self, wanted: int) -> None:
        if not self.path.exists() or self.path.stat().st_size + wanted <= self.max_bytes // FILES:
            return
        for number in range(FILES - 1, 0, -1):
            older = self.path if number == 1 else self._numbered(number - 1)
            if older.exists():
                older.replace(self._numbered(number))

    def _numbered(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}")


def audit_log(state_dir: Path, max_bytes: int) -> AuditLog:
    """The log of one machine's state folder."""
    return AuditLog(path=state_dir.resolve() / "audit" / "audit.jsonl", max_bytes=max_bytes)
