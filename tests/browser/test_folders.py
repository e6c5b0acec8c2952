"""A folder dropped from the desktop: drawn before a byte is sent, uploaded with its paths, and then it moves."""

import json
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, Route, expect

from tests.browser.conftest import JOB_MS, MOVING, Open, Viewer, pixels
from tests.plant import stand

UPRIGHT = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]
"""Columns: +Z up in the buffer is +Y up in the scene, as Sketchfab exports it."""


@pytest.fixture
def sketchfab(tmp_path: Path) -> Path:
    """A folder as Sketchfab packs it: `scene.gltf`, `scene.bin`, `textures/`, and notes."""
    folder = tmp_path / "red oak"
    (folder / "textures").mkdir(parents=True)
    mesh = stand.tree(6.0, num_cards=120)
    uv = np.random.default_rng(0).random((mesh.num_vertices, 2)).astype(np.float32)
    arrays = [mesh.vertices.astype(np.float32), uv, mesh.faces.astype(np.uint32)]
    starts = np.cumsum([0, *(array.nbytes for array in arrays)]).tolist()
    (folder / "scene.bin").write_bytes(b"".join(array.tobytes() for array in arrays))
    Image.new("RGB", (64, 64), (230, 20, 20)).save(folder / "textures" / "leaf baseColor.png")
    (folder / "license.txt").write_text("made by the test")
    (folder / ".DS_Store").write_bytes(b"hidden")
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Sketchfab_model", "matrix": UPRIGHT, "children": [1]}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "doubleSided": True}],
        "textures": [{"source": 0}],
        "images": [{"uri": "textures/leaf%20baseColor.png"}],
        "buffers": [{"uri": "scene.bin", "byteLength": starts[-1]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": array.nbytes}
            for start, array in zip(starts, arrays, strict=False)
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": mesh.num_vertices,
                "type": "VEC3",
                "min": mesh.vertices.min(axis=0).tolist(),
                "max": mesh.vertices.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5126, "count": mesh.num_vertices, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5125, "count": mesh.faces.size, "type": "SCALAR"},
        ],
    }
    (folder / "scene.gltf").write_text(json.dumps(document))
    return folder


def drop(page: Page, *paths: Path) -> None:
    """Drop files and folders of this machine on the page, as a file manager does."""
    session = page.context.new_cdp_session(page)
    files = [str(path) for path in paths]
    for kind in ("dragEnter", "dragOver", "drop"):
        dragged = {"items": [], "files": files, "dragOperationsMask": 1}
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 300, "y": 300, "data": dragged})
        if kind == "dragOver":
            expect(page.locator("#veil")).to_be_visible()


def red_pixels(viewer: Viewer) -> int:
    """How many pixels the texture of the leaves colours."""
    picture = pixels(viewer)
    return int((picture[..., 0] > 2 * picture[..., 1:].max(axis=2) + 20).sum())


def test_a_dropped_folder_is_drawn_then_uploaded_then_moves(view: Open, url: str, sketchfab: Path) -> None:
    viewer = view(900, 620)
    page = viewer.page
    waiting: list[Route] = []

    def hold(route: Route) -> None:
        waiting.append(route)

    page.route("**/v1/assets", hold)
    viewer.open(url)
    drop(page, sketchfab)
    expect(page.locator("#veil")).to_be_hidden()
    expect(page.locator("#progress-title")).to_have_text("red oak")
    expect(page.locator("#height-note")).to_contain_text("m high")
    for _ in range(120):
        if red_pixels(viewer) > 500:
            break
        page.wait_for_timeout(500)
    assert red_pixels(viewer) > 500, "the tree or its texture is not drawn"
    assert len(waiting) == 1, "a byte was sent, or nothing is about to be sent"
    waiting[0].continue_()
    page.unroute("**/v1/assets")
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    viewer.wait_frames(3)
    assert red_pixels(viewer) > 500, "the texture is lost"
    job = httpx.get(f"{url}/v1/jobs/{page.url.split('=')[-1]}", timeout=60).json()
    asset = httpx.get(f"{url}/v1/assets/{job['asset_id']}", timeout=60).json()
    assert {"scene.gltf", "scene.bin", "textures/leaf baseColor.png"} <= {part["name"] for part in asset["parts"]}
