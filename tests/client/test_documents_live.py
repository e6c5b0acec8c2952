"""What the documents tell to type does what they say, against a real service: `<!-- run: live -->` before a block."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark import ParameterSet
from dynamictree_client import Client, models, operations

from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.gaussian.from_mesh import splats_of_mesh
from lab.dataset.sample import make_sample, voxel_spectrum
from recipes import batch
from tests.formats.meshes import written
from tests.reconstruct.conftest import photographed

ROOT = Path(__file__).parents[2]
MARKED = re.compile(r"<!-- run: live -->\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


def marked_blocks() -> Iterator[ParameterSet]:
    """Each block of the documentation that says that it runs, and the README's example in Python."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for number, (language, text) in enumerate(MARKED.findall(page.read_text())):
            yield pytest.param(language, text, id=f"{page.stem}-{number}-{language}")
    [example] = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    yield pytest.param("python", example, id="README-python")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the reader is, with a tree as a mesh and as a splat, its spectrum, and photos."""
    folder = tmp_path_factory.mktemp("reader")
    sample = make_sample(3, "sapling")
    mesh = sample.mesh
    (folder / "tree.spectrum.safetensors").write_bytes(written(write_spectrum, voxel_spectrum(sample, 64)[1]))
    for name in ("tree.glb", "oak.glb"):
        (folder / name).write_bytes(written(write_glb, mesh))
    cloud = splats_of_mesh(mesh, at_least=20_000, rng=np.random.default_rng(0)).cloud
    (folder / "plant.ply").write_bytes(written(write_gaussian_ply, cloud))
    (folder / "photos").mkdir()
    photographed(folder / "photos")
    return folder


def run(language: str, text: str, folder: Path, url: str) -> str:
    # recipes and benchmarks are run from the clone
    environment = {"URL": url, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", "-"] if language == "python" else ["bash", "-euo", "pipefail"]
    text = text.replace("http://127.0.0.1:8000", url).replace("localhost:8000", url.removeprefix("http://"))
    answer = subprocess.run(
        command,
        input=text,
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert answer.returncode == 0, f"{text}\n{answer.stdout}\n{answer.stderr}"
    return answer.stdout


@pytest.mark.parametrize(("language", "text"), list(marked_blocks()))
def test_a_marked_block_runs(language: str, text: str, url: str, folder: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    printed = run(language, text, folder, url)
    written = [path for path in folder.rglob("*") if before.get(path) != path.stat().st_mtime_ns]
    assert printed or written or "assert" in text, "the block leaves nothing that a reader could see"


def test_the_readmes_curl_lines_and_the_push_run(url: str, folder: Path) -> None:
    blocks = re.findall(r"^```sh\n(.*?)^```$", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    (text,) = [block for block in blocks if "dynamictree serve" in block and "curl" in block]
    lines = [line for line in text.splitlines() if not line.startswith((". .venv", "dynamictree serve", "URL="))]
    assert sum("curl" in line for line in lines) >= 7  # ready, upload, job, wait, list, download, result, push
    with Client(url) as client:
        job = client.wait(client.animate(folder / "tree.glb", models.AnimateParams(wind=models.Wind(speed_m_s=6))))
        assert job.result is not None
        run("sh", f"URL={url}/v1\n" + "\n".join(lines), folder, url)
        (push,) = re.findall(r"^```sh\n(curl .*?)^```$", (ROOT / "docs/interaction.md").read_text(), re.M | re.S)
        assert client.modes(job.result.spectrum_id)
        placed = push.replace("01…", str(job.result.spectrum_id)).replace('"point_m": [0.2, 0.0, 7.9]', '"voxel": 9')
        assert "01…" in push
        assert '"groups"' in run("sh", placed, folder, url)


def test_a_batch_goes_on_where_it_stopped_and_names_what_failed(url, tmp_path, capsys) -> None:
    trees = tmp_path / "trees"
    trees.mkdir()
    for seed in (3, 4, 5):
        (trees / f"tree-{seed}.glb").write_bytes(written(write_glb, make_sample(seed, "sapling").mesh))
    arguments = [str(trees), "-o", str(tmp_path / "out"), "--url", url, "--num-steps", "1"]
    assert batch.main(arguments) == 0
    first = (tmp_path / "out" / "tree-4" / "tree.glb").read_bytes()
    with Client(url) as client:
        before = len(client.send(operations.list_jobs(limit=100)).data)
        (trees / "broken.glb").write_bytes(b"no tree")
        assert batch.main(arguments) == 1
        assert len(client.send(operations.list_jobs(limit=100)).data) == before
    assert (tmp_path / "out" / "tree-4" / "tree.glb").read_bytes() == first
    output = capsys.readouterr().out
    assert "3 of 3 trees sway" in output
    assert "3 of 4 trees sway" in output
    assert "broken.glb: unsupported-format" in output or "broken.glb: invalid" in output
