"""Time to import the service in a new process, with files in the page cache and bytecode from `make setup`."""

import os
import subprocess
import sys

from benchmarks._machine import machine, time_calls

TARGET_S = 0.7


def run() -> dict[str, object]:
    # without bytecode files, Python would compile this project's own modules in every run
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    loaded = time_calls(
        lambda: subprocess.run([sys.executable, "-c", "import service.app"], check=True, env=environment), runs=5
    )
    bare = time_calls(lambda: subprocess.run([sys.executable, "-c", ""], check=True, env=environment), runs=5)
    return {
        "value": round(loaded.median_ms / 1e3, 3),
        "unit": "s",
        "target": TARGET_S,
        "of_which_bare_python_s": round(bare.median_ms / 1e3, 3),
        "runs": 5,
        **machine("fastapi", "pydantic", "sqlalchemy"),
    }
