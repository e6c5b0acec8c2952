"""All trees of some folders on one page: preview, size, warnings, seconds and memory, as the command makes them.

python -m recipes.gallery trees/ more-trees/ -o build/gallery

Each file is animated by its own `dynamictree animate`. A refused file has its error in place of the picture.
"""

import argparse
import html
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dynamictree.formats.suffixes import CLOUD_SUFFIXES, MESH_SUFFIXES

NO_TREES = ("license.txt", "readme.txt", "sources.md")
NO_FOLDER = "licenses"
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem; max-width: 80rem }
section { display: grid; grid-template-columns: minmax(0, 34rem) 1fr; gap: 0 1.5rem; padding: 1rem 0 }
h2 { font-size: 1.05rem; margin: 0 } img { width: 100% } .error { color: #a00 } li { margin: .2rem 0 }
"""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Result of the command for one file."""

    name: str
    folder: str  # folder of its products, beside the page
    seconds: float
    processor_s: float
    peak_mib: float
    error: str | None
    lines: tuple[str, ...]  # size and warnings as printed by the command
    facts: dict[str, object]


def tree_files(folders: list[Path]) -> Iterator[tuple[str, Path]]:
    """Iterate over every mesh, splat and scan in the folders, with its name there."""
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            readable = path.suffix.lower() in {*MESH_SUFFIXES, *CLOUD_SUFFIXES}
            if path.is_file() and readable and path.name.lower() not in NO_TREES and NO_FOLDER not in path.parts:
                yield str(path.relative_to(folder.parent)), path


def animate(name: str, path: Path, output: Path, options: list[str]) -> Row:
    """Run the command on one file."""
    folder = name.replace("/", "-")
    command = [sys.executable, "-m", "dynamictree.cli", "animate", str(path), "-o", str(output / folder), "--json"]
    began = time.perf_counter()
    with (output / "stdout").open("w+") as printed, (output / "stderr").open("w+") as messages:
        process = subprocess.Popen([*command, "--format", "glb,png", *options], stdout=printed, stderr=messages)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0)
        messages.seek(0)
        lines = tuple(line for line in messages.read().splitlines() if line.strip())
        facts = json.loads(printed.read() or "{}") if process.returncode == 0 else {}
    return Row(
        name=name,
        folder=folder,
        seconds=time.perf_counter() - began,
        processor_s=used.ru_utime + used.ru_stime,
        peak_mib=used.ru_maxrss / 1024,
        error=None if process.returncode == 0 else lines[-1] if lines else f"exit status {process.returncode}",
        lines=lines if process.returncode == 0 else lines[:-1],
        facts=facts,
    )


def gallery_page(rows: list[Row], output: Path) -> str:
    """Return the page with all rows as HTML."""
    moving = sum(row.error is None for row in rows)
    sections = "\n".join(_section(row, output) for row in rows)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Gallery</title><style>{STYLE}</style>'
        f"<h1>Gallery</h1><p>{moving} of {len(rows)} files move.</p>{sections}"
    )


def _section(row: Row, output: Path) -> str:
    facts = [f"{name}: {value}" for name, value in row.facts.items() if name != "files"]
    items = "".join(f"<li>{html.escape(line)}</li>" for line in (*row.lines, *facts))
    cost = f"{row.seconds:.1f} s, {row.processor_s:.1f} s of processor, {row.peak_mib:.0f} MiB"
    title = html.escape(row.name)
    return (
        f"<section><div>{_picture(row, output)}</div><div><h2>{title}</h2><p>{cost}</p><ul>{items}</ul></div></section>"
    )


def _picture(row: Row, output: Path) -> str:
    pictures = sorted((output / row.folder).glob("preview*.png"))
    if row.error is not None or not pictures:
        return f'<p class="error">{html.escape(row.error or "there is no preview")}</p>'
    address = html.escape(f"{row.folder}/{pictures[0].name}")
    return f'<a href="{address}"><img src="{address}" alt="{html.escape(row.name)}"></a>'


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="of meshes, splats and scans")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/gallery"))
    parser.add_argument("--options", default="", help="more options of `dynamictree animate`, in one string")
    chosen = parser.parse_args(arguments)
    chosen.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, path in tree_files(chosen.folders):
        rows.append(animate(name, path, chosen.output, chosen.options.split()))
        state = rows[-1].error or "moves"
        print(f"{name}: {state} ({rows[-1].seconds:.1f} s)", flush=True)
        (chosen.output / "index.html").write_text(gallery_page(rows, chosen.output))
    return 0 if rows else 2


if __name__ == "__main__":
    sys.exit(main())
