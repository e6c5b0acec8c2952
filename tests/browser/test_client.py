"""The JavaScript client, in node against a real service."""

import os
import shutil
import subprocess
from pathlib import Path

from dynamictree.formats.mesh_file import read_mesh

TESTS = Path(__file__).with_name("client.test.mjs")


def test_the_client_in_node(url: str, tree: Path, tmp_path: Path) -> None:
    node = shutil.which("node")
    assert node, "no node: install node 20 or newer"
    with tree.open("rb") as stream:
        mesh = read_mesh(stream, file_type="glb")
    large = tmp_path / "large.obj"  # made large by comments
    with large.open("w") as out:
        out.writelines(f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in mesh.vertices)
        out.writelines(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in mesh.faces)
        out.writelines(f"# {'x' * 997}\n" for _ in range(20_000))
    environment = os.environ | {"SERVICE_URL": url, "TREE": str(tree), "LARGE": str(large)}
    done = subprocess.run(
        [node, "--experimental-websocket", "--test", "--test-concurrency=1", str(TESTS)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-3000:]
    assert "# fail 0" in done.stdout
    assert "# skipped 0" in done.stdout
