"""How long a new process needs to import the service, files in the page cache, bytecode as `make setup` leaves it."""

import os
import subprocess
import sys

from benchmarks._machine import machine, timed

TARGET_S = 0.7


def run() -> dict[str, object]:
    # where Python may not write bytecode, this project's own modules would be compiled in every run
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    loaded = timed(
        lambda: subprocess.run([sys.executable, "-c", "import service.app"], check=True, env=environment), runs=5
    )
    bare = timed(lambda: subprocess.run([sys.executable, "-c", ""], check=True, env=environment), runs=5)
    return {
        "value": round(loaded.median_ms / 1e3, 3),
        "unit": "s",
        "target": TARGET_S,
        "of_which_bare_python_s": round(bare.median_ms / 1e3, 3),
        "runs": 5,
        **machine("fastapi", "pydantic", "sqlalchemy"),
    }
