"""`make compose`: docker-compose.yml from an empty engine to a second start, one line with seconds for each step.

Uses the machine's engine, or a private one (see engine.py). Everything is removed at the end; `--keep` leaves it.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx

from tests.compose.base_images import ensure_base_images
from tests.compose.drill import Drill
from tests.compose.engine import disk_bytes, running_engine

ROOT = Path(__file__).parents[2]
PROJECT = "dynamictree-drill"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", choices=("auto", "private"), default="auto")
    parser.add_argument("--folder", type=Path, default=Path(".cache/engine"), help="of the private engine")
    parser.add_argument("--port", type=int, default=8642)
    parser.add_argument("--keep", action="store_true", help="leave containers and volumes")
    parser.add_argument("--built", action="store_true", help="take the image that an earlier run built")
    arguments = parser.parse_args()
    began = time.monotonic()
    subprocess.run([sys.executable, "docker/make_secrets.py"], cwd=ROOT, check=True)
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with running_engine(folder, private=arguments.engine == "private") as engine, tempfile.TemporaryDirectory() as own:
        override = Path(own) / "override.json"
        override.write_text(json.dumps(_override(engine.private)))
        files = ["-f", "docker-compose.yml", "-f", str(override)]
        os.environ["PORT"] = str(arguments.port)
        compose = (engine.docker, "compose", "-p", PROJECT, *files)
        with httpx.Client(base_url=f"http://127.0.0.1:{arguments.port}", timeout=120) as client:
            drill = Drill(
                compose=compose, environment=dict(engine.environment) | {"PORT": str(arguments.port)}, client=client
            )
            drill.tell("engine", began, engine.run("version", "--format", "{{.Server.Version}}").strip())
            with drill.step("base images") as notes:
                notes.append(json.dumps(ensure_base_images(engine, folder)))
            drill.docker("down", "--volumes", check=False)  # what an interrupted run left
            try:
                drill.run_all(build=not arguments.built, image_bytes=lambda: disk_bytes(engine, "dynamictree:0.1.0"))
            finally:
                drill.write_logs(folder / "containers.log")
                if not arguments.keep:
                    drill.docker("down", "--volumes", "--timeout", "30")
    drill.tell("all", began, f"{len(drill.steps)} steps")


def _override(private: bool) -> dict[str, object]:
    """A private engine's containers have no way out, so that the build has the network of the machine."""
    build: dict[str, object] = {"network": "host"} if private else {}
    wheels = os.environ.get("PIP_FIND_LINKS", "")
    if Path(wheels).is_dir() and wheels:
        build["additional_contexts"] = {"wheels": wheels}
    return {"services": {name: {"build": build} for name in ("api", "worker", "housekeeper")} if build else {}}


if __name__ == "__main__":
    main()
