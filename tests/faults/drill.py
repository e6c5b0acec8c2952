"""What the drills that take minutes to hours have in common: a folder, and lines of JSON."""

import argparse
import json
import signal
import sys
import tempfile
from pathlib import Path


def tell(what: dict[str, object]) -> None:
    """Print one line."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def parse(parser: argparse.ArgumentParser, *, prefix: str) -> tuple[argparse.Namespace, Path]:
    """Arguments, and the folder for logs and products; SIGTERM ends what was started."""
    parser.add_argument("--keep", type=Path, help="folder for logs and products; a temporary one if unset")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))
    folder = arguments.keep or Path(tempfile.mkdtemp(prefix=prefix))
    folder.mkdir(parents=True, exist_ok=True)
    return arguments, folder
