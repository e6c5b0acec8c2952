"""Results that the documents tell: recorded as JSON, filled into `results/page.md`, written to docs/results.md.

`python -m benchmarks._results record NAME [COMMAND …]` runs a benchmark, or any command whose last line is a JSON
object, and writes that object to `benchmarks/results/NAME.json`. `python -m benchmarks._results write` makes the page.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from benchmarks._machine import machine

FOLDER = Path(__file__).with_name("results")
PAGE = Path(__file__).parent.parent / "docs" / "results.md"
WEIGHTS = Path(__file__).parent.parent / "dynamictree" / "weights" / "small.safetensors"


def record(name: str, command: Sequence[str]) -> None:
    """Run a command, by default the benchmark of this name, and store the JSON object of its last line."""
    run = subprocess.run(command or [sys.executable, "-m", "benchmarks", name], stdout=subprocess.PIPE, check=True)
    result = json.loads(run.stdout.decode().splitlines()[-1])
    stored = {"weights": weights_hash(), **machine(), **result}
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n")


def rendered() -> str:
    """The page: each `{name[key]…:format}` of the template is a value of the recorded result of that name."""
    results = {path.stem: json.loads(path.read_text()) for path in sorted(FOLDER.glob("*.json"))}
    return (FOLDER / "page.md").read_text().format(**results)


def weights_hash() -> str:
    """First digits of the sha256 of the shipped weights, by which a result of older weights is known."""
    return sha256(WEIGHTS.read_bytes()).hexdigest()[:12]


def main() -> None:
    """Record one result, or write the page."""
    match sys.argv[1:]:
        case ["write"]:
            PAGE.write_text(rendered())
        case ["record", name, *command]:
            record(name, command)
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
