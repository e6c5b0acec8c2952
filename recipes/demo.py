"""A tree mesh goes in over HTTP and comes out swaying: what `make demo` runs.

Starts `dynamictree serve` on a free port with its embedded Redis, SQLite and local folder; uploads a tree; polls;
downloads every product; pushes a branch through /v1/interact; stops the service.
"""

import argparse
import hashlib
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from safetensors.numpy import load, load_file

SPECIES = "round-broadleaf"
SEED = 7
PULL_S = 0.5
PUSH_FRAMES = 240
START_TIMEOUT_S = 120.0  # the first imports from a cold disk can take half a minute


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--input", type=Path, help="a mesh of yours: OBJ, PLY, GLB, glTF or STL")
    parser.add_argument("--output", type=Path, default=Path("demo-output"), help="folder for the products")
    arguments = parser.parse_args()
    output: Path = arguments.output
    output.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    mesh_path = arguments.input or grow_demo_tree(output / "input.glb")
    with tempfile.TemporaryDirectory(prefix="dynamictree-") as state, serve(Path(state), output / "serve.log") as url:
        print(f"== serving at {url}")
        with httpx.Client(base_url=url, timeout=60) as client:
            job = animate(client, mesh_path)
            paths = download(client, job, output)
            push = push_branch(client, job, paths["tree.spectrum.safetensors"], output / "push.json")
    print()
    for stage in job["stages"]:
        seconds = datetime.fromisoformat(stage["finished_at"]) - datetime.fromisoformat(stage["started_at"])
        print(f"  {stage['name']:<10} {seconds.total_seconds():6.1f} s")
    print(f"  interact   {push['seconds'] * 1e3:6.0f} ms for {PUSH_FRAMES} frames")
    print(f"  all        {time.perf_counter() - began:6.1f} s")
    print(
        f"\n  the branch: pulled {push['pulled_m'] * 100:.1f} cm aside, {push['left_m'] * 100:.2f} cm left at the end\n"
    )
    for path in [*paths.values(), output / "push.json"]:
        print(f"  {path}  {path.stat().st_size / 1e6:.2f} MB")


def grow_demo_tree(path: Path) -> Path:
    """Write a tree of the project's own generator."""
    from dynamictree.formats.gltf.writer import write_glb
    from lab.dataset.sample import make_sample

    print(f"== growing a tree: species {SPECIES}, seed {SEED}")
    with path.open("wb") as stream:
        write_glb(make_sample(SEED, SPECIES).mesh, stream)
    return path


@contextmanager
def serve(state: Path, log_path: Path) -> Iterator[str]:
    """Context manager that runs a separate service on a free port and yields its URL."""
    command = [
        sys.executable,
        "-m",
        "dynamictree.cli",
        "serve",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--state-dir",
        str(state),
    ]
    print("== starting the service", file=sys.stderr)
    with (
        log_path.open("w") as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True) as process,
    ):
        try:
            yield wait_ready(process, log_path)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=60)
    print("== stopped the service", file=sys.stderr)


def wait_ready(process: subprocess.Popen[str], log_path: Path) -> str:
    """Read the service's standard output up to its line `ready http://…`."""
    deadline = time.monotonic() + START_TIMEOUT_S
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("ready "):
            return line.split()[1]
        if time.monotonic() > deadline:
            break
    raise SystemExit(f"the service did not start; its log is {log_path}")


def animate(client: httpx.Client, mesh_path: Path) -> dict[str, Any]:
    """Upload the mesh, create a job for its motion, and poll until the job has ended."""
    print(f"== uploading {mesh_path} ({mesh_path.stat().st_size / 1e6:.2f} MB)")
    with mesh_path.open("rb") as stream:
        asset = response_body(client.post("/v1/assets", files={"file": (mesh_path.name, stream)}))
    request = {"type": "animate", "asset_id": asset["id"], "seed": SEED, "params": {"formats": ["ply", "glb", "png"]}}
    job = response_body(client.post("/v1/jobs", json=request))
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns) as progress:
        bars: dict[str, TaskID] = {}
        while job["state"] in ("queued", "running"):
            response = client.get(f"/v1/jobs/{job['id']}")
            job = response_body(response)
            for stage in job["stages"]:
                if stage["name"] not in bars:
                    bars[stage["name"]] = progress.add_task(stage["name"], total=1.0)
                progress.update(bars[stage["name"]], completed=stage["progress"])
            time.sleep(float(response.headers.get("Retry-After", "1")))
    if job["state"] != "succeeded":
        raise SystemExit(f"the job {job['state']}: {json.dumps(job['error'], indent=2)}")
    return job


def download(client: httpx.Client, job: dict[str, Any], folder: Path) -> dict[str, Path]:
    """Fetch every artefact of the job and compare it with the manifest's sha256."""
    paths = {}
    for artifact in response_body(client.get(f"/v1/jobs/{job['id']}/artifacts"))["artifacts"]:
        path = folder / artifact["name"]
        digest = hashlib.sha256()
        with client.stream("GET", artifact["url"]) as response, path.open("wb") as stream:
            response.raise_for_status()
            for chunk in response.iter_bytes():
                digest.update(chunk)
                stream.write(chunk)
        if digest.hexdigest() != artifact["sha256"]:
            raise SystemExit(
                f"{path} does not match the manifest: {digest.hexdigest()} instead of {artifact['sha256']}"
            )
        paths[artifact["name"]] = path
    return paths


def push_branch(client: httpx.Client, job: dict[str, Any], spectrum_path: Path, answer_path: Path) -> dict[str, float]:
    """Pull the voxel farthest from the trunk aside by a twentieth of the height, release it, and measure its swing.

    Returns:
        Time of the answer, how far the voxel is pulled, and how far it still swings after PUSH_FRAMES [s, m, m].
    """
    tensors = load_file(spectrum_path)
    outward = (tensors["coords"] - tensors["coords"].mean(axis=0))[:, :2]
    tip = int(np.argmax(np.linalg.norm(outward, axis=1)))
    x, y = outward[tip] / np.linalg.norm(outward[tip])
    aside = np.array([-y, x, 0.0])  # perpendicular to the branch, which hardly moves along its axis
    metadata = response_body(client.get(f"/v1/spectra/{job['result']['spectrum_id']}"))
    aside_m = 0.05 * float(np.ptp(tensors["coords"][:, 2])) * metadata["voxel_size_m"]
    pull = {"kind": "drag", "at": {"voxel": tip}, "displacement_m": (aside_m * aside).tolist(), "duration_s": PULL_S}
    request = {"spectrum_id": job["result"]["spectrum_id"], "forces": [pull], "start": "held", "dt_s": 1 / 60}
    request |= {"num_frames": PUSH_FRAMES, "output": "modal"}
    began = time.perf_counter()
    answer = response_body(client.post("/v1/interact", json=request))
    seconds = time.perf_counter() - began
    answer_path.write_text(json.dumps(answer))
    later = {"initial_state": answer["final_state"], "forces": [], "num_frames": 30, "output": "voxels"}
    swing = load(checked(client.post("/v1/interact", json=request | later)).content)["displacement"][:, tip]
    pulled_m, left_m = float(aside @ answer["reached"][0]["reached_m"]), float(np.abs(swing @ aside).max())
    return {"seconds": seconds, "pulled_m": pulled_m, "left_m": left_m}


def response_body(response: httpx.Response) -> dict[str, Any]:
    """Return the response's JSON body, or exit with the problem that the service reported."""
    body: dict[str, Any] = checked(response).json()
    return body


def checked(response: httpx.Response) -> httpx.Response:
    """Return the response, or exit with the problem that the service reported."""
    if response.is_error:
        raise SystemExit(f"{response.request.method} {response.request.url}: {response.status_code}\n{response.text}")
    return response


if __name__ == "__main__":
    main()
