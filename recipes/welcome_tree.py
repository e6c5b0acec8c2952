"""Write what the tree behind the page's welcome moves by: its surface and its modes, as the service serves them.

    python -m recipes.welcome_tree

Runs a service of its own on one of the page's examples, with the shipped model. The files are thinned for a download:
every eighth voxel, since voxels only say where a pull takes hold; the bins that move no point by a pixel left out;
places to 2 mm, and turns in coarser steps, which gzip packs.
"""

import argparse
import gzip
import json
import tempfile
from pathlib import Path

import httpx
import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from recipes.demo import response_body, serve

EXAMPLES = Path(__file__).parents[1] / "web" / "examples"
LONGEST_S = 600.0
EVERY_VOXEL = 8
COARSER = 8
"""Factor on the step of a bone's turn; the error of positions is 0.03 % of the height, a fifth of a pixel."""
PLACES = dict.fromkeys(("vertices", "turn_foot_m", "turn_direction", "joint_place_m"), 2 ** (-9))
PLACES |= {"flutter_axis": 2**-5, "flutter_critical_m_s": 2**-5}
"""Steps of positions [m] and directions; their float32 values then end with zero bits, which compress well."""
BINS = 16
"""Number of bins retained, 0 to 1.8 Hz: the tree is 600 pixels high, and the other bins move no point by a pixel."""
PER_VOXEL = ("coords", "bone_of_voxel")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--example", default="round-broadleaf", help="name of a mesh in web/examples")
    parser.add_argument("--output", type=Path, default=EXAMPLES, help="folder for the two files")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dynamictree-") as folder:
        state = Path(folder)
        with (
            serve(state / "state", state / "serve.log") as url,
            httpx.Client(base_url=url, timeout=LONGEST_S) as client,
        ):
            write_motion(client, EXAMPLES / f"{arguments.example}.glb", arguments.output)


def write_motion(client: httpx.Client, mesh: Path, output: Path) -> None:
    """Write `<name>.surface.safetensors` and `<name>.modes.safetensors` beside each other."""
    asset = response_body(client.post("/v1/assets", files={"file": (mesh.name, mesh.read_bytes())}))
    job = response_body(client.post("/v1/jobs", json={"type": "diffuse", "asset_id": asset["id"], "seed": 7}))
    while job["state"] in ("queued", "running"):
        job = response_body(client.get(f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=30"}))
    if job["state"] != "succeeded":
        raise SystemExit(f"the job {job['state']}: {job['error']}")
    for name in ("surface", "modes"):
        path = output / f"{mesh.stem}.{name}.safetensors"
        url = f"/v1/spectra/{job['result']['spectrum_id']}/{name}"
        path.write_bytes(client.get(url, params={"shapes": False}).raise_for_status().content)
        path.write_bytes(reduce_file(path))
        print(
            f"{path}  {path.stat().st_size / 1e6:.2f} MB, {len(gzip.compress(path.read_bytes(), 6)) / 1e6:.2f} packed"
        )


def reduce_file(path: Path) -> bytes:
    """Return a surface or modes file reduced to a fraction of its size."""
    with safe_open(path, "np") as file:
        metadata, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if "coords" in tensors:
        tensors |= {name: np.ascontiguousarray(tensors[name][::EVERY_VOXEL]) for name in PER_VOXEL}
        tensors["frequencies_hz"] = tensors["frequencies_hz"][:BINS].copy()
    if "turn_shapes" in tensors:
        zero = json.loads(metadata["planes"])["turn_shapes"]
        low, high = tensors["turn_shapes"][:, :, :BINS].astype(np.int32)
        steps = np.rint((low + 256 * high - zero) / COARSER).astype(np.int32) + zero
        tensors["turn_shapes"] = np.stack([steps & 255, steps >> 8]).astype(np.uint8)
        tensors["turn_step_rad"] *= np.float32(COARSER)
    for name in tensors.keys() & PLACES:
        tensors[name] = np.float32(np.rint(tensors[name] / PLACES[name]) * PLACES[name])
    return save(tensors, metadata)


if __name__ == "__main__":
    main()
