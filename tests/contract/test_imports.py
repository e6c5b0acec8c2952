import subprocess
import sys

import pytest

HEAVY = {
    "torch",
    "numba",
    "trimesh",
    "celery",
    "alembic",
    "pycolmap",
    "skimage",
    "scipy.sparse",
    "scipy.spatial",
    "httpx",
}


@pytest.mark.parametrize("module", ["service.app", "service.local.serve", "service.local.doctor", "jobs.store"])
def test_importing_the_service_loads_nothing_heavy(module: str) -> None:
    program = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) & HEAVY == set()
    assert not [name for name in done.stdout.split() if name == "worker" or name.startswith("worker.")]


def test_importing_the_worker_loads_no_service() -> None:
    program = "import sys, worker.app, worker.housekeeper; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) & {"torch", "fastapi", "service", "starlette"} == set()
