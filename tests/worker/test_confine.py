"""What a confined process can no longer do: each tried in a process of its own, before and after."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ATTEMPTS = """
import json, os, socket, subprocess, sys
from pathlib import Path
from worker.confine import confine

folder, secret = Path(sys.argv[1]), Path(sys.argv[2])
def tried(what):
    try:
        what()
    except OSError as error:
        return type(error).__name__
    return "done"
attempts = {
    "write inside": lambda: (folder / "made").write_text("x"),
    "write outside": lambda: (secret.parent / "made").write_text("x"),
    "read a secret": secret.read_text,
    "look at another process": lambda: Path(f"/proc/{os.getppid()}/environ").read_bytes(),
    "open a socket": socket.socket,
    "make a pair of sockets": socket.socketpair,
    "run a program": lambda: subprocess.run(["/bin/true"], check=True),
    "end another process": lambda: os.kill(os.getppid(), 0),
    "read a library": lambda: Path(os.__file__).read_bytes(),
}
before = {name: tried(what) for name, what in attempts.items()}
(folder / "made").unlink(); (secret.parent / "made").unlink()
holds = confine(folder)
print(json.dumps([before, {name: tried(what) for name, what in attempts.items()}, holds]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="Landlock and seccomp are Linux's")
def test_a_confined_process_reaches_neither_network_nor_programs_nor_other_files(tmp_path: Path) -> None:
    folder, secret = tmp_path / "own", tmp_path / "other" / "secret"
    folder.mkdir()
    secret.parent.mkdir()
    secret.write_text("secret")
    program = [sys.executable, "-c", ATTEMPTS, str(folder), str(secret)]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    before, after, holds = json.loads(done.stdout)
    assert set(before.values()) == {"done"}
    allowed = {"write inside", "read a library"}
    if "landlock" not in holds:
        allowed |= {"write outside", "read a secret", "look at another process"}
    assert "seccomp" in holds
    assert after == {name: "done" if name in allowed else "PermissionError" for name in before}
