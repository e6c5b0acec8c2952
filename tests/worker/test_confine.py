"""What a confined process can no longer do: each tried in a process of its own, before and after."""

import ctypes.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import worker.confine
from jobs.storage.parser_process import FOLDER, child_environment

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Landlock and seccomp are Linux's")


def printed(program: str, *arguments: object, **options: Any) -> Any:
    """The JSON that a program prints in a process of its own."""
    command = [sys.executable, "-P", "-c", program, *map(str, arguments)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, **options).stdout)


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


def test_a_confined_process_reaches_neither_network_nor_programs_nor_other_files(tmp_path: Path) -> None:
    folder, secret = tmp_path / "own", tmp_path / "other" / "secret"
    folder.mkdir()
    secret.parent.mkdir()
    secret.write_text("secret")
    before, after, holds = printed(ATTEMPTS, folder, secret)
    assert set(before.values()) == {"done"}
    allowed = {"write inside", "read a library"}
    if "landlock" not in holds:
        allowed |= {"write outside", "read a secret", "look at another process"}
    assert "seccomp" in holds
    assert after == {name: "done" if name in allowed else "PermissionError" for name in before}


RUN = """
import json, shutil, subprocess, sys
from pathlib import Path
from worker.confine import confine

program, copy = Path(sys.argv[2]), Path(sys.argv[1], "copy")
holds = confine(Path(sys.argv[1]), program=program)
shutil.copy(program, copy)
def tried(path):
    try:
        return subprocess.run([path, "-version"], capture_output=True).returncode
    except PermissionError:
        return "PermissionError"
print(json.dumps([tried(program), tried("/bin/true"), tried(copy), holds]))
"""


def test_a_confined_process_runs_the_program_that_it_needs_and_no_other(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed").get_ffmpeg_exe()
    needed, other, copied, holds = printed(RUN, tmp_path, ffmpeg)
    assert (needed, "seccomp" in holds) == (0, True)
    if "landlock" in holds:
        assert (other, copied) == ("PermissionError", "PermissionError")


SECRETS = (".ssh/id_rsa", "state/jobs.sqlite", "docker/secrets/postgres_password")
READ = """
import json, os, sys
from pathlib import Path
from worker.confine import confine

confine(Path(sys.argv[1]))
def tried(name):
    try:
        Path(sys.argv[2], name).read_bytes()
    except OSError as error:
        return type(error).__name__
    return "read"
print(json.dumps({name: tried(name) for name in sys.argv[3:]} | {"environment": dict(os.environ)}))
"""


def test_the_folder_that_the_service_was_started_from_stays_closed(tmp_path, monkeypatch) -> None:
    """As a user starts it: with a current folder, a home, a PYTHONPATH and credentials."""
    folder, home = tmp_path / "own", tmp_path / "home"
    folder.mkdir()
    for name in SECRETS:
        (home / name).parent.mkdir(parents=True)
        (home / name).write_text("secret")
    (home / "pydantic.py").write_text("import pathlib; pathlib.Path(__file__).with_name('executed').touch()")
    monkeypatch.chdir(home)
    for name, value in {"HOME": str(home), "PYTHONPATH": str(home), "AWS_SECRET_ACCESS_KEY": "secret"}.items():
        monkeypatch.setenv(name, value)
    result = printed(READ, folder, home, *SECRETS, env=child_environment(), cwd=FOLDER)
    environment = result.pop("environment")
    assert result == dict.fromkeys(SECRETS, "PermissionError")
    assert str(home) not in json.dumps(environment)
    assert not [name for name in environment if "SECRET" in name or name.startswith(("DYNAMICTREE", "AWS"))]
    assert not (home / "executed").exists()


def test_the_checkout_beside_the_code_stays_closed(tmp_path: Path) -> None:
    """An editable install lies in a checkout, whose other folders are nobody's business."""
    root = Path(worker.confine.__file__).parents[1]
    names = ("docker-compose.yml", "worker/parse.py")
    result = printed(READ, tmp_path, root, *names, env=child_environment(), cwd=FOLDER)
    assert (result["docker-compose.yml"], result["worker/parse.py"]) == ("PermissionError", "read")


def test_denied_calls_have_the_numbers_of_libseccomp() -> None:
    library = ctypes.util.find_library("seccomp")
    if library is None:
        pytest.skip("no libseccomp on this machine")
    number_of = ctypes.CDLL(library).seccomp_syscall_resolve_name_arch
    for i, architecture in enumerate(worker.confine._MACHINES.values()):
        expected = {name: number_of(architecture, name.encode()) for name in worker.confine._DENIED}
        assert {name: numbers[i] for name, numbers in worker.confine._DENIED.items()} == expected


def test_readers_start_where_no_folder_is_writable_and_models_need_no_kernels() -> None:
    environment = child_environment() | {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    loads = "import sys, worker.parse_server; print(int('dynamictree.gaussian.turn' in sys.modules))"
    assert printed(loads + "; import worker.confined_reading", env=environment, cwd=FOLDER) == 0
