"""How long a new process needs to import the service, files in the page cache, bytecode as `make setup` leaves it."""

import os
import subprocess
import sys

from benchmarks._machine import device, timed, versions

TARGET_S = 0.7


def run() -> dict[str, object]:
    # where Python may not write bytecode, this project's own modules would be compiled in every run
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    seconds = timed(lambda: subprocess.run([sys.executable, "-c", "import service.app"], check=True, env=environment))
    bare = timed(lambda: subprocess.run([sys.executable, "-c", ""], check=True, env=environment))
    return {
        "value": round(seconds["median_s"], 3),
        "unit": "s",
        "target": TARGET_S,
        "of_which_bare_python_s": round(bare["median_s"], 3),
        "runs": 5,
        "device": device(),
        "versions": versions("fastapi", "pydantic", "sqlalchemy"),
    }
