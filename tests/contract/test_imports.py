import subprocess
import sys

import grimp
import networkx

HEAVY = {"torch", "numba", "trimesh", "celery", "pyapriltags", "pycolmap", "skimage", "httpx"}
HEAVY |= {"scipy.sparse", "scipy.spatial"}


def test_importing_the_service_loads_nothing_heavy() -> None:
    program = "import sys, service.app, service.local.serve, jobs.store; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) & HEAVY == set()
    assert not [name for name in done.stdout.split() if name == "worker" or name.startswith("worker.")]


def test_importing_the_worker_loads_no_service() -> None:
    program = "import sys, worker.app, worker.housekeeper; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) & {"torch", "fastapi", "service", "starlette"} == set()


def test_no_modules_import_one_another_in_a_circle() -> None:
    graph = grimp.build_graph("jobs", "service", "worker", cache_dir=None)  # imports for type checking included
    imports = [(one, other) for one in graph.modules for other in graph.find_modules_directly_imported_by(one)]
    circles = [sorted(c) for c in networkx.strongly_connected_components(networkx.DiGraph(imports)) if len(c) > 1]
    assert circles == []
