"""Run the benchmarks that are named, or all of them, each in a process of its own: a JSON object per line, and a table.

What needs a tool that is missing is skipped by name; what fails is named, and the others go on.
"""

import importlib
import json
import os
import pkgutil
import subprocess
import sys
import time
from pathlib import Path

import benchmarks
from benchmarks._table import table

TABLE = Path("build/benchmarks.md")


def names() -> list[str]:
    """Names of all benchmarks."""
    return sorted(
        module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.name.startswith("_")
    )


def main() -> int:
    """Exit status: 1 if a benchmark failed."""
    unknown = [name for name in sys.argv[1:] if name not in names()]
    if unknown:
        raise SystemExit(f"benchmarks: no such name: {', '.join(unknown)}; there are {', '.join(names())}")
    for name in sys.argv[1:]:
        print(json.dumps({"benchmark": name, **importlib.import_module(f"benchmarks.{name}").run()}), flush=True)
    return 0 if sys.argv[1:] else _all(names())


def _all(names: list[str]) -> int:
    rows = []
    for name in names:
        rows.append({"benchmark": name, **_outcome(name)})
        print(json.dumps(rows[-1]), flush=True)
        TABLE.parent.mkdir(parents=True, exist_ok=True)
        TABLE.write_text(table(rows))
    print(f"benchmarks: the table is {TABLE}", file=sys.stderr)
    return int(any("failed" in row for row in rows))


def _outcome(name: str) -> dict[str, object]:
    began, load = time.perf_counter(), os.getloadavg()[0]
    run = subprocess.run([sys.executable, "-m", "benchmarks", name], capture_output=True, text=True, check=False)
    if run.returncode == 0:
        result: dict[str, object] = json.loads(run.stdout.splitlines()[-1])
        return {"load": round(load, 2), "took_s": round(time.perf_counter() - began, 1), **result}
    *_, reason = ["", *run.stderr.splitlines()]
    return {"skipped" if reason.startswith("benchmarks: ") else "failed": reason}


if __name__ == "__main__":
    sys.exit(main())
