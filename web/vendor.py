"""Fetch the viewer's libraries from npm anew: `python -m web.vendor`, after changing a version and its hash here.

Every tarball is compared with the hash that stands here; of each only the named files are kept, byte for byte.
`vendor/SHA256SUMS` lists them, and a test compares.
"""

import base64
import hashlib
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent / "vendor"
SUMS = "SHA256SUMS"


@dataclass(frozen=True, kw_only=True)
class Library:
    """One package of npm, and the files of it that are served."""

    name: str
    version: str
    sha512: str  # npm's `dist.integrity`, base64
    files: dict[str, str]  # path in the package to path in `vendor/`


LIBRARIES = (
    Library(
        name="three",
        version="0.187.0",
        sha512="Qiu7R+Cmh8CstZsY1uJOSWnVlfo7ZtNLV7mF8Jltk3LB3AtDu9cRZlcnRKkAk8Y4z6KKw35z7Y7Urd7jWY8etA==",
        files={
            "LICENSE": "three/LICENSE",
            "build/three.core.js": "three/three.core.js",
            "build/three.module.js": "three/three.module.js",
            "examples/jsm/controls/OrbitControls.js": "three/addons/controls/OrbitControls.js",
            "examples/jsm/postprocessing/Pass.js": "three/addons/postprocessing/Pass.js",
        },
    ),
    Library(
        name="@sparkjsdev/spark",
        version="2.2.0",
        sha512="wf5F2YAmPXnjm20/MgXYer9FQTXz2JOCo05HwxFkaD7Guk9rHVPIwdJ6fq0oF9ME0heMvYj+TxS6DTrucvy6KA==",
        files={"LICENSE": "spark/LICENSE", "dist/spark.module.min.js": "spark/spark.module.min.js"},
    ),
    Library(  # inside of Spark's file
        name="fflate",
        version="0.8.2",
        sha512="cPJU47OaAoCbg0pBvzsgpTPhmhqI5eJjh/JIu8tPj5q+T7iLvW/JAYUqmE7KOB4R1ZyEhzBaIQpQpardBF5z8A==",
        files={"LICENSE": "spark/LICENSE.fflate"},
    ),
)


def main() -> None:
    """Replace `vendor/` by what npm gives."""
    lines = []
    for library in LIBRARIES:
        for path, content in sorted(fetch(library).items()):
            target = FOLDER / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
            lines.append(f"{hashlib.sha256(content).hexdigest()}  {path}\n")
        sys.stdout.write(f"{library.name} {library.version}: {len(library.files)} files\n")
    (FOLDER / SUMS).write_text("".join(lines))


def fetch(library: Library) -> dict[str, bytes]:
    """The library's files by their path in `vendor/`."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            ["npm", "pack", "--silent", f"{library.name}@{library.version}"],
            cwd=folder,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        [tarball] = Path(folder).iterdir()
        found = base64.b64encode(hashlib.sha512(tarball.read_bytes()).digest()).decode()
        if found != library.sha512:
            raise SystemExit(
                f"{tarball.name} has sha512 {found}; {library.sha512} is expected: look before you change it"
            )
        with tarfile.open(tarball) as archive:
            return {target: _content(archive, f"package/{path}") for path, target in library.files.items()}


def _content(archive: tarfile.TarFile, name: str) -> bytes:
    stream = archive.extractfile(name)
    assert stream is not None
    return stream.read()


if __name__ == "__main__":
    main()
