"""Jobs from photos to a moving splat of the plant alone, over HTTP, on four typical sets.

A tree on a lawn under a cloudy sky in changing light; a thin sapling there with a mask per photo; RGBA pictures of a 3D
program with their cameras; with DYNAMICTREE_SAMPLES set, 16 real photos of a banana. `plant_iou` compares, in the
photos that the splat was not learned from, the pixels of the plant with those that the result covers;
DYNAMICTREE_BENCHMARK_SETS selects some of lawn, thin, rgba and banana, and DYNAMICTREE_BENCHMARK_OUTPUT is a folder for
the products of each job.
"""

import json
import os
import tempfile
import time
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks._machine import BRIEF, machine
from benchmarks._photo_lawn import photograph_on_lawn
from benchmarks._photo_set import photograph
from benchmarks._whole_service import WholeService, stage_seconds, whole_service
from dynamictree.formats.splat.ply import read_gaussian_ply
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.reconstruct.photo_cameras import read_cameras

TARGET_IOU = 0.9
PHOTOS, SIDE_PX = 30, 640
FORMATS = ["splat", "png"]
PATIENCE_S = 7200.0
Masks = dict[str, np.ndarray]
"""Coverage of each photo's pixels by the plant, 0 to 255, by the photo's name."""


def run() -> dict[str, object]:
    sets = {"lawn": _lawn, "thin": _thin_plant, "rgba": _rgba}
    if os.environ.get("DYNAMICTREE_SAMPLES"):
        sets["banana"] = _banana
    chosen = os.environ.get("DYNAMICTREE_BENCHMARK_SETS", "rgba" if BRIEF else ",".join(sets)).split(",")
    rows = {}
    with whole_service() as service:
        for name in chosen:
            with tempfile.TemporaryDirectory() as folder:
                rows[name] = _through_http(service, name, Path(folder), sets[name](Path(folder)))
    iou = [row["plant_iou"] for row in rows.values() if row["plant_iou"] is not None]
    return {"value": min(iou, default=None), "unit": "IoU", "target": TARGET_IOU, "sets": rows, **machine("numpy")}


def _lawn(folder: Path) -> Masks:
    return photograph_on_lawn(folder, number=36, side=SIDE_PX)


def _thin_plant(folder: Path) -> Masks:
    """Write photos and an exact mask of each."""
    masks = photograph_on_lawn(folder, number=PHOTOS, side=SIDE_PX, species="sapling", height_m=2.0, seed=3)
    (folder / "masks").mkdir()
    for name, mask in masks.items():
        Image.fromarray(np.where(mask > 127, 255, 0).astype(np.uint8)).save(
            folder / "masks" / Path(name).with_suffix(".png")
        )
    return masks


def _rgba(folder: Path) -> Masks:
    photos = photograph(folder, number=PHOTOS, side=SIDE_PX)
    return {path.name: np.asarray(Image.open(path))[..., 3] for path in photos}


def _banana(folder: Path) -> Masks:
    for path in (Path(os.environ["DYNAMICTREE_SAMPLES"]) / "photos" / "banana").glob("*.JPG"):
        (folder / path.name).write_bytes(path.read_bytes())
    return {}


def _through_http(service: WholeService, name: str, folder: Path, masks: Masks) -> dict[str, Any]:
    """Upload the folder, run a job for the moving plant, and evaluate the resulting splat."""
    began, before_s = time.perf_counter(), service.worker_s()
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    files = [("file", (str(path.relative_to(folder)), path.read_bytes())) for path in paths]
    asset = service.client.post("/v1/assets", files=files).raise_for_status().json()["id"]
    job = service.wait(service.submit(asset, only_plant=True, formats=FORMATS), PATIENCE_S)
    artifacts = service.client.get(f"/v1/jobs/{job['id']}/artifacts").raise_for_status().json()["artifacts"]
    got = {file["name"]: service.client.get(file["url"]).raise_for_status().content for file in artifacts}
    wall_s = time.perf_counter() - began
    if output := os.environ.get("DYNAMICTREE_BENCHMARK_OUTPUT"):
        for file, content in got.items():
            path = Path(output) / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    report = json.loads(got["report.json"])
    return {
        "minutes": round(wall_s / 60, 2),
        "worker_s": round(service.worker_s() - before_s, 1),
        "stages_s": stage_seconds(job),
        "num_photos": report["num_photos"],
        "num_registered": report["num_registered"],
        "held_out_psnr_db": report["held_out_psnr_db"],
        "held_out_masked_psnr_db": report["held_out_masked_psnr_db"],
        "num_gaussians": report["num_gaussians"],
        "plant_iou": _plant_iou(got, report["held_out"], masks) if masks else None,
        "warnings": report["warnings"],
    }


def _plant_iou(got: dict[str, bytes], held_out: list[str], masks: Masks) -> float:
    """Return the IoU over all held-out photos together."""
    plant = read_gaussian_ply(BytesIO(got["splat.ply"]))
    both = either = 0
    for view in read_cameras(json.loads(got["cameras.json"])):
        if view.photo not in held_out:
            continue
        drawn = render_cloud(plant, view.camera, width=view.width, height=view.height).alpha > 0.5
        mask = Image.fromarray(masks[view.photo])
        aside = [(whole - part) / 2 for whole, part in zip(mask.size, drawn.shape[::-1], strict=True)]
        cropped = mask.transform(  # crop about the middle, as the undistorted photo is
            drawn.shape[::-1], Image.Transform.AFFINE, (1, 0, aside[0], 0, 1, aside[1]), Image.Resampling.BILINEAR
        )
        true = np.asarray(cropped) > 127
        both += int((drawn & true).sum())
        either += int((drawn | true).sum())
    return round(both / either, 3)
