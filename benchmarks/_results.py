"""Results in the documentation: recorded as JSON, filled into templates, written to the results page and the README.

`python -m benchmarks._results NAME …` measures the named results (by default all of COMMANDS), stores the JSON object
of each one's last line as `benchmarks/results/NAME.json`, and writes both; `write` alone only writes them.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks._machine import machine

ROOT = Path(__file__).parent.parent
FOLDER = Path(__file__).with_name("results")
PAGE, README = ROOT / "docs" / "results.md", ROOT / "README.md"
WEIGHTS = ROOT / "dynamictree" / "weights" / "small.safetensors"
EVALUATE = "-m dynamictree.cli evaluate --json"
COMMANDS = {
    "motion": f"{EVALUATE} --trees 8 --training-trees 6",
    **{name: f"-m benchmarks {name}" for name in ("wind_condition", "storm_stretch", "engine_exports")},
    **{name: f"-m benchmarks {name}" for name in ("plant_verdicts", "modal_coordinates", "modal_frame")},
    **{name: f"-m benchmarks {name}" for name in ("deform_gaussians", "bind_gaussians", "render_frame")},
    **{name: f"-m benchmarks {name}" for name in ("interact_latency", "import_service", "serve_start")},
    "animate_service": "-m benchmarks animate_service",
}
"""Arguments of Python that measure each result."""
SHORT = {"DYNAMICTREE_BENCHMARK_SIZES": "1964", "DYNAMICTREE_BENCHMARK_RUNS": "3"}
"""Environment of the benchmarks: the demo tree and one size, three times each."""
WEIGHT_RESULTS = ("motion", "wind_condition", "storm_stretch")
"""Results that depend on the weights."""


def record(name: str) -> None:
    """Measure one result and store it; leave the earlier result where its sample files are missing."""
    if name == "motion" and not os.environ.get("DYNAMICTREE_SAMPLES"):
        print("motion is not measured: set DYNAMICTREE_SAMPLES, whose trees are of another simulator")
        return
    command = [sys.executable, *shlex.split(COMMANDS[name])]
    run = subprocess.run(command, stdout=subprocess.PIPE, check=True, env=SHORT | os.environ)
    result = json.loads(run.stdout.decode().splitlines()[-1])
    stored = {"weights": weights_hash(), **machine(), **result}
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n")


def fill_template(template: str) -> str:
    """Fill a template: each `{name[key]…:format}` is a value of the recorded result of that name.

    Lines whose result was not recorded are left out, with tables and sections that become empty; `{weights}` lists
    those results.
    """
    results = {path.stem: json.loads(path.read_text()) for path in sorted(FOLDER.glob("*.json"))}
    values = results | {"weights": _state(results)} | _tables(results)
    lines = (FOLDER / template).read_text().splitlines(keepends=True)
    text = "".join(line for line in lines if set(re.findall(r"\{(\w+)", line)) <= set(values)).format(**values)
    text = re.sub(r"^\|.*\n\|[-|]+\n(?!\|)", "", text, flags=re.MULTILINE)  # drop tables without a row
    return re.sub(
        r"^## .*\n\s*(?=## )", "", re.sub(r"\n{3,}", "\n\n", text), flags=re.MULTILINE
    )  # drop sections without text


def _state(results: Mapping[str, Any]) -> str:
    older = [name for name in WEIGHT_RESULTS if name in results and results[name]["weights"] != weights_hash()]
    missing = [name for name in COMMANDS if name not in results]
    of_weights = f"Of earlier weights: {', '.join(older)}." if older else "All are of the shipped weights."
    return of_weights + (f" Not measured yet: {', '.join(missing)}." if missing else "")


def _tables(results: Mapping[str, Any]) -> dict[str, object]:
    """Return template values that combine several numbers of a result."""
    values: dict[str, object] = {}
    if "wind_condition" in results:
        values["wind_rows"] = "\n".join(map(_wind_row, results["wind_condition"]["value"]))
    if "storm_stretch" in results:
        values["storm_rows"] = "\n".join(_storm_row(*item) for item in results["storm_stretch"]["trees"].items())
    if "plant_verdicts" in results:
        values["num_kinds"] = len(results["plant_verdicts"]["kinds"])
    return values


def readme() -> str:
    """Return the README with its section on results filled in."""
    before, _, after = README.read_text().partition("## Results\n")
    return before + fill_template("readme.md") + after[after.index("## ") :]


def _wind_row(row: dict[str, float]) -> str:
    return (
        "| {speed_m_s:.0f} | {gust} | {direction_deg:.0f}° | {model_amplitude:.4f} ({truth_amplitude:.4f}) | "
        "{model_lean:.4f} ({truth_lean:.4f}) | {model_lean_direction_deg:.0f}° ({truth_lean_direction_deg:.0f}°) |"
    ).format(**row)


def _storm_row(name: str, row: dict[str, dict[str, float]]) -> str:
    storm, hurricane = row["20_m_s"], row["30_m_s"]
    cells = (storm["frames_edges"], hurricane["frames_edges"], storm["added_edges"], hurricane["added_edges"])
    return f"| {Path(name).name} | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |"


def weights_hash() -> str:
    """Return the first digits of the sha256 of the shipped weights, which reveal results of older weights."""
    return sha256(WEIGHTS.read_bytes()).hexdigest()[:12]


def main() -> None:
    """Measure the named results, then write the page and the README."""
    names = sys.argv[1:] or list(COMMANDS)
    if unknown := set(names) - {*COMMANDS, "write"}:
        raise SystemExit(f"no such results: {', '.join(sorted(unknown))}; there are {', '.join(COMMANDS)}")
    for name in names:
        if name != "write":
            record(name)
    PAGE.write_text(fill_template("page.md"))
    README.write_text(readme())


if __name__ == "__main__":
    main()
