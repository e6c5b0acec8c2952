"""Fetch the viewer's libraries from npm: `python -m web.vendor`, after changing a version and its hash below.

Every tarball is compared with the hash below. The named files are copied from it; scripts that are not minified yet
are minified by a pinned esbuild. `vendor/SHA256SUMS` lists the results, and a test compares them.
"""

import base64
import hashlib
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path

MINIFY = ("npx", "--yes", "esbuild@0.28.2", "--minify", "--legal-comments=inline", "--target=es2022", "--loader=js")
MODULE = "--format=esm"
FOLDER = Path(__file__).parent / "vendor"
SUMS = "SHA256SUMS"
OWN_LICENCE = Path(__file__).parents[1] / "LICENSE"


@dataclass(frozen=True, kw_only=True)
class Library:
    """One package of npm, and the files of it that are served."""

    name: str
    version: str
    sha512: str  # npm's `dist.integrity`, base64
    files: dict[str, str]  # path in the package to path in the library's folder
    apache: bool = False  # its licence is this project's, whose text the package lacks

    @property
    def targets(self) -> list[str]:
        """Paths in `vendor/` of its files."""
        return [self.target(path) for path in (*self.files.values(), *(["LICENSE"] if self.apache else []))]

    def target(self, path: str) -> str:
        """Path in `vendor/` of a file. It holds the version, so that browsers may cache it for ever."""
        return f"{self.name.rpartition('/')[2]}-{self.version}/{path}"


LIBRARIES = (
    Library(
        name="three",
        version="0.187.0",
        sha512="Qiu7R+Cmh8CstZsY1uJOSWnVlfo7ZtNLV7mF8Jltk3LB3AtDu9cRZlcnRKkAk8Y4z6KKw35z7Y7Urd7jWY8etA==",
        files={
            "LICENSE": "LICENSE",
            "build/three.core.js": "three.core.js",
            "build/three.module.js": "three.module.js",
            "examples/jsm/controls/OrbitControls.js": "addons/controls/OrbitControls.js",
            "examples/jsm/loaders/GLTFLoader.js": "addons/loaders/GLTFLoader.js",
            "examples/jsm/loaders/MTLLoader.js": "addons/loaders/MTLLoader.js",
            "examples/jsm/loaders/OBJLoader.js": "addons/loaders/OBJLoader.js",
            "examples/jsm/loaders/PLYLoader.js": "addons/loaders/PLYLoader.js",
            "examples/jsm/loaders/STLLoader.js": "addons/loaders/STLLoader.js",
            "examples/jsm/postprocessing/Pass.js": "addons/postprocessing/Pass.js",
            "examples/jsm/utils/BufferGeometryUtils.js": "addons/utils/BufferGeometryUtils.js",
            "examples/jsm/utils/SkeletonUtils.js": "addons/utils/SkeletonUtils.js",
        },
    ),
    Library(
        name="@sparkjsdev/spark",
        version="2.2.0",
        sha512="wf5F2YAmPXnjm20/MgXYer9FQTXz2JOCo05HwxFkaD7Guk9rHVPIwdJ6fq0oF9ME0heMvYj+TxS6DTrucvy6KA==",
        files={"LICENSE": "LICENSE", "dist/spark.module.min.js": "spark.module.min.js"},
    ),
    Library(  # zip archives; Spark's file contains it as well
        name="fflate",
        version="0.8.2",
        sha512="cPJU47OaAoCbg0pBvzsgpTPhmhqI5eJjh/JIu8tPj5q+T7iLvW/JAYUqmE7KOB4R1ZyEhzBaIQpQpardBF5z8A==",
        files={"LICENSE": "LICENSE", "esm/browser.js": "fflate.js"},
    ),
    Library(  # laser scans
        name="laz-perf",
        version="0.0.7",
        sha512="2xRqm/f/2UqDS5qqkjOyDb6uVIjkVw6SGmQlMoTQliVWkZhPfIbUJTubUl3mTloaWqKcjlS/urmP1CYoxelsEg==",
        files={"lib/web/laz-perf.js": "laz-perf.js", "lib/web/laz-perf.wasm": "laz-perf.wasm"},
        apache=True,
    ),
    Library(  # the page of the API, /docs
        name="swagger-ui-dist",
        version="5.35.0",
        sha512="U06rpMtW9V3XPGOBeamTUSr0Z09jMX4IJuANpE/EZbAhw0G8CgwrzU4YmXkn/h0wCDNsXdGarTNNHC3sU8yVUQ==",
        files={
            "LICENSE": "LICENSE",
            "NOTICE": "LICENSE.notice",
            "swagger-ui-bundle.js": "swagger-ui-bundle.js",
            "swagger-ui-bundle.js.LICENSE.txt": "LICENSE.bundle",
            "swagger-ui.css": "swagger-ui.css",
        },
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
        sys.stdout.write(f"{library.name} {library.version}: {len(library.targets)} files\n")
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
        digest = base64.b64encode(hashlib.sha512(tarball.read_bytes()).digest()).decode()
        if digest != library.sha512:
            raise SystemExit(
                f"{tarball.name} has sha512 {digest}; {library.sha512} is expected: look before you change it"
            )
        with tarfile.open(tarball) as archive:
            contents = {target: _content(archive, f"package/{path}") for path, target in library.files.items()}
    if library.apache:
        contents["LICENSE"] = OWN_LICENCE.read_bytes()
    return {library.target(path): _minified(path, content) for path, content in contents.items()}


def _minified(path: str, content: bytes) -> bytes:
    if not path.endswith(".js") or path.endswith((".min.js", "-bundle.js")):
        return content
    command = (*MINIFY, MODULE) if b"module.exports" in content else MINIFY
    minified: bytes = subprocess.run(command, input=content, check=True, capture_output=True).stdout
    return minified


def _content(archive: tarfile.TarFile, name: str) -> bytes:
    stream = archive.extractfile(name)
    assert stream is not None
    return stream.read()


if __name__ == "__main__":
    main()
