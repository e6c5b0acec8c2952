"""Check the words of names and prose, and the size of the code: `python -m tests.style`, part of `make check`."""

import subprocess
import sys
from pathlib import Path

from tests.style import house
from tests.style.words import violations

ROOT = Path(__file__).resolve().parents[2]


def tracked_files() -> list[str]:
    """Paths of the files that git tracks or would add, relative to the repository's root."""
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return [path for path in listed if (ROOT / path).is_file()]


def main() -> None:
    """Print every violation; exit with 1 if there is one."""
    messages = [message for path in tracked_files() for message in violations(path, (ROOT / path).read_bytes())]
    sys.stdout.write("".join(f"{message}\n" for message in messages))
    if messages:
        sys.exit(f"{len(messages)} banned words; CONTRIBUTING.md (Names and words) lists what to write instead")
    if too_large := list(house.violations(ROOT)):
        sys.exit("\n".join(too_large))


if __name__ == "__main__":
    main()
