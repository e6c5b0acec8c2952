"""`python -m service.openapi --write FILE` or `--check FILE`: write or compare the committed OpenAPI document."""

import argparse
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from jobs.settings import Settings
from service.app import create_app


def openapi_text() -> str:
    """The page, as it is committed."""
    with TemporaryDirectory() as folder:
        page = create_app(Settings(state_dir=Path(folder))).openapi()
    return json.dumps(page, indent=1, ensure_ascii=False) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or compare it; 1 where it differs."""
    parser = argparse.ArgumentParser(prog="python -m service.openapi")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path, metavar="FILE")
    what.add_argument("--check", type=Path, metavar="FILE")
    chosen = parser.parse_args(arguments)
    if chosen.write is not None:
        chosen.write.parent.mkdir(parents=True, exist_ok=True)
        chosen.write.write_text(openapi_text())
        return 0
    if chosen.check.is_file() and chosen.check.read_text() == openapi_text():
        return 0
    sys.stderr.write(f"{chosen.check} is not the application's own; run `make openapi`\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
