"""A Docker engine for the drill: the one that is running, or a private one from Debian's packages.

The private engine needs root on a Debian-like machine. Its packages are unpacked, not installed; its socket, data and
processes live in one folder, and it is stopped by process id. Its containers reach one another and have no way out.
"""

import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

MIRROR = os.environ.get("DEBIAN_MIRROR", "http://deb.debian.org/debian")
PACKAGES = {
    "trixie": ("docker.io", "docker-cli", "docker-compose", "docker-buildx", "containerd", "tini", "debootstrap"),
    "bookworm": (  # trixie's ask for a newer C library than Debian 12 has
        "runc",
        *("iptables", "libxtables12", "libip4tc2", "libip6tc2", "libmnl0", "libnftnl11"),
        *("libnetfilter-conntrack3", "libnfnetlink0"),
    ),
}
"""Docker and what it calls. A container's DNS is a rule of iptables in the container's own network."""

START_S = 90
STOP_S = 60


def run_program(
    command: Sequence[str], environment: Mapping[str, str], *, timeout_s: float, check: bool, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end; with `check`, a failure is a RuntimeError with what the program wrote."""
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
    )
    if check and done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}:\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done


@dataclass(frozen=True, kw_only=True)
class Engine:
    """How to reach an engine."""

    docker: str
    environment: Mapping[str, str]
    private: bool

    def run(self, *command: str, timeout_s: float = 120, check: bool = True) -> str:
        """Run a docker command and return what it prints."""
        done = run_program((self.docker, *command), self.environment, timeout_s=timeout_s, check=check)
        return done.stdout + (done.stderr if not check else "")


@contextmanager
def running_engine(folder: Path, *, private: bool) -> Iterator[Engine]:
    """Yield the machine's engine, or start a private one in `folder` where there is none."""
    docker = shutil.which("docker")
    if not private and docker and _answers(docker, os.environ):
        yield Engine(docker=docker, environment=os.environ, private=False)
        return
    root = unpack_engine(folder)
    with _daemon(folder, root) as engine:
        yield engine


def _answers(docker: str, environment: Mapping[str, str]) -> bool:
    for command in (["info"], ["compose", "version"]):
        done = subprocess.run([docker, *command], env=environment, capture_output=True, timeout=30, check=False)
        if done.returncode != 0:
            return False
    return True


def unpack_engine(folder: Path) -> Path:
    """Unpack Debian's packages below `folder` and return their root."""
    root = folder / "root"
    if root.exists():
        return root
    apt = apt_environment(folder)
    debs, unpacked = folder / "debs", folder / "root.part"
    debs.mkdir(parents=True, exist_ok=True)
    for suite, names in PACKAGES.items():
        command = ["apt-get", "download", *(f"{name}/{suite}" for name in names)]
        subprocess.run(command, cwd=debs, env=apt, check=True, stdout=sys.stderr)
    shutil.rmtree(unpacked, ignore_errors=True)
    for deb in sorted(debs.glob("*.deb")):
        subprocess.run(["dpkg", "-x", str(deb), str(unpacked)], check=True)
    for name in ("iptables", "ip6tables"):  # else links of Debian's alternatives
        (unpacked / "usr" / "sbin" / name).unlink(missing_ok=True)
        (unpacked / "usr" / "sbin" / name).symlink_to("xtables-legacy-multi")
    return unpacked.rename(root)


def apt_environment(folder: Path) -> Mapping[str, str]:
    """Make an apt of our own, which knows two releases of Debian and changes nothing of the machine's."""
    apt = folder / "apt"
    for name in ("state/lists/partial", "cache/archives/partial"):
        (apt / name).mkdir(parents=True, exist_ok=True)
    keyring = "/usr/share/keyrings/debian-archive-keyring.gpg"
    (apt / "sources.list").write_text("".join(f"deb [signed-by={keyring}] {MIRROR} {s} main\n" for s in PACKAGES))
    (apt / "apt.conf").write_text(
        f'Dir::State "{apt}/state";\nDir::Cache "{apt}/cache";\nDir::Etc::sourcelist "{apt}/sources.list";\n'
        'Dir::Etc::sourceparts "-";\nDir::State::status "/var/lib/dpkg/status";\nAPT::Sandbox::User "root";\n'
    )
    environment = os.environ | {"APT_CONFIG": str(apt / "apt.conf")}
    if not any((apt / "state" / "lists").glob("*Packages*")):
        subprocess.run(["apt-get", "-q", "update"], env=environment, check=True, stdout=sys.stderr)
    return environment


@contextmanager
def _daemon(folder: Path, root: Path) -> Iterator[Engine]:
    state = folder / "state"
    configuration = folder / "config"
    plugins = configuration / "cli-plugins"
    plugins.mkdir(parents=True, exist_ok=True)
    for plugin in (root / "usr" / "libexec" / "docker" / "cli-plugins").iterdir():
        (plugins / plugin.name).unlink(missing_ok=True)
        (plugins / plugin.name).symlink_to(plugin)
    state.mkdir(exist_ok=True)
    programs = [root / "usr" / name for name in ("bin", "sbin")]
    socket = state / "docker.sock"
    environment = os.environ | {
        "PATH": ":".join([*map(str, programs), os.environ["PATH"]]),
        "LD_LIBRARY_PATH": str(root / "usr" / "lib" / f"{platform.machine()}-linux-gnu"),
        "XTABLES_LIBDIR": str(root / "usr" / "lib" / f"{platform.machine()}-linux-gnu" / "xtables"),
        "DOCKER_HOST": f"unix://{socket}",
        "DOCKER_CONFIG": str(configuration),
    }
    command = [
        str(root / "usr" / "sbin" / "dockerd"),
        f"--host=unix://{socket}",
        f"--data-root={state / 'data'}",
        f"--exec-root={state / 'exec'}",
        f"--pidfile={state / 'docker.pid'}",
        f"--init-path={root / 'usr' / 'bin' / 'tini-static'}",
        "--storage-driver=overlay2",
        "--bip=10.222.0.1/24",
        "--default-address-pool=base=10.223.0.0/16,size=24",
        *(f"--{name}=false" for name in ("iptables", "ip6tables", "ip-forward", "ip-masq")),
    ]
    with (folder / "dockerd.log").open("wb") as log:
        daemon = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
    engine = Engine(docker=str(root / "usr" / "bin" / "docker"), environment=environment, private=True)
    try:
        deadline = time.monotonic() + START_S
        while not _answers(engine.docker, environment):
            if daemon.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"the engine does not start; see {folder / 'dockerd.log'}")
            time.sleep(0.5)
        yield engine
    finally:
        daemon.send_signal(signal.SIGTERM)
        try:
            daemon.wait(STOP_S)
        except subprocess.TimeoutExpired:
            daemon.kill()
            daemon.wait()


def disk_bytes(engine: Engine, image: str) -> int:
    """Return the size of an image, as `docker image ls` counts it."""
    [description] = json.loads(engine.run("image", "inspect", image))
    return int(description["Size"])
