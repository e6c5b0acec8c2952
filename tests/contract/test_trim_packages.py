"""docker/trim_packages.py, which takes what nothing reads out of the image's packages."""

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = Path(sysconfig.get_paths()["platlib"])

pytestmark = pytest.mark.skipif(shutil.which("strip") is None, reason="binutils are not installed")


def trim(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "docker" / "trim_packages.py"), str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def put(path: Path, source: Path | None = None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(source.read_bytes() if source else b"x" * 100)
    return path


def test_what_is_read_at_run_time_stays(tmp_path: Path) -> None:
    stays = [put(tmp_path / name) for name in ("torch/version.py", "skimage/__init__.pyi", "skimage/data/__init__.py")]
    goes = [put(tmp_path / name) for name in ("torch/include/a.h", "numpy/ma/tests/t.py", "skimage/data/cat.png")]
    done = trim(tmp_path)
    assert done.returncode == 0, done.stderr
    assert [path.exists() for path in (*stays, *goes)] == [True] * 3 + [False] * 3


def test_a_library_that_strip_damages_ends_the_build(tmp_path: Path) -> None:
    [fortran] = (PACKAGES / "numpy.libs").glob("libgfortran-*")
    [quad] = (PACKAGES / "numpy.libs").glob("libquadmath-*")
    for folder, code in (("numpy.libs", 0), ("other.libs", 1)):
        put(tmp_path / folder / quad.name, quad)
        library = put(tmp_path / folder / fortran.name, fortran)
        done = trim(tmp_path)
        assert done.returncode == code, done.stderr
    assert f"strip damaged {library}" in done.stderr
