"""Remove what the service never reads from installed packages: headers, tests, sample pictures, symbols of libraries.

`python trim_packages.py SITE_PACKAGES` in the image's build. Each library that loaded before is loaded again
afterwards: one that `strip` damaged ends the build.
"""

import ctypes
import multiprocessing
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

FOLDERS = ("torch/include", "torch/test", "torch/share")
TESTED = ("networkx", "numba", "numpy", "scipy", "skimage", "sympy")
"""Packages whose folders named `tests` go."""

FILES = ("torch/**/*.pyi", "torch/bin/*", "torch/lib/*test.so", "skimage/data/*", "**/*.a")
STAYING = ("torch_shm_manager", "*.py", "*.py?")
"""Files that stay, of these. skimage reads its `.pyi` files at run time, torch does not."""

UNSTRIPPED = ("numpy.libs/*", "scipy.libs/*", "omppool.*")
"""Libraries that do not load any more once they are stripped."""


def trim(packages: Path) -> int:
    """Return how many bytes went."""
    before = _bytes(packages)
    doomed = [packages / name for name in FOLDERS]
    doomed += [path for name in TESTED for path in (packages / name).rglob("tests") if path.is_dir()]
    for path in doomed:
        shutil.rmtree(path, ignore_errors=True)
    for path in {path for pattern in FILES for path in packages.glob(pattern)}:
        if path.is_file() and not any(path.match(name) for name in STAYING):
            path.unlink()
    loadable = _loadable(packages)
    for library in _libraries(packages):
        if any(library.match(name) for name in UNSTRIPPED):
            continue
        subprocess.run(["strip", "--strip-unneeded", str(library)], check=True)
    damaged = sorted(loadable - _loadable(packages))
    if damaged:
        raise SystemExit(f"strip damaged {', '.join(damaged)}: leave these libraries as they are")
    return before - _bytes(packages)


def _bytes(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*"))


def _libraries(packages: Path) -> list[Path]:
    return sorted(path for path in packages.rglob("*.so*") if path.is_file() and not path.is_symlink())


def _loadable(packages: Path) -> set[str]:
    """Names of the libraries that load; each package's in a process of its own, as two of them may not agree."""
    families = defaultdict(list)
    for library in _libraries(packages):
        families[library.relative_to(packages).parts[0]].append(library)
    with multiprocessing.Pool(1, maxtasksperchild=1) as pool:
        return set().union(*pool.map(_load, families.values(), chunksize=1))


def _load(libraries: list[Path]) -> set[str]:
    loaded = set()
    for library in libraries:
        try:
            ctypes.CDLL(str(library))
        except OSError:
            continue
        loaded.add(str(library))
    return loaded


if __name__ == "__main__":
    print(f"{trim(Path(sys.argv[1])) / 1e6:.0f} MB removed")  # noqa: T201
