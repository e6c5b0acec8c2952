"""What stands still because it is no plant, in a mesh and in a splat: it does not move."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import Material
from lab.dataset.sample import make_sample
from tests.browser.conftest import Open, Viewer, changed, job_of, picture_of, scrub
from tests.clouds import cloud_at
from tests.devoxelize.test_interpolation import merged, tube
from tests.formats.meshes import written

POT_M = 0.5
TERRACOTTA = (0.62, 0.17, 0.06)
DISPLACEMENTS = """async (spectrum) => {
    const load = (path) => import(`/web/${path}.js`);
    const [{ Client }, { Stage }, { Tree }] = await Promise.all(["client", "draw/stage", "draw/tree"].map(load));
    const [{ readSurface }, { Modes, windCoordinates }] = await Promise.all(
        ["draw/surface", "motion/modes"].map(load));
    const client = new Client();
    const surface = await readSurface(await client.surface(spectrum));
    const modes = new Modes(await client.modes(spectrum));
    const stage = new Stage(document.createElement("canvas"));
    const tree = new Tree(stage);
    tree.setSurface(surface);
    tree.setModes(modes);
    tree.swing({ q: windCoordinates(modes.K, 0.3), turn: 0.4 });
    tree.bend([]);
    tree.prepare(stage.renderer);
    const { target, rows } = tree.field;
    const texels = new Float32Array(4 * 2048 * rows);
    stage.renderer.readRenderTargetPixels(target, 0, 0, 2048, rows, texels);
    const most = { still: 0, others: 0, bones: 0, count: 0 };
    for (let v = 0; v < surface.N; v++) {
        const kind = surface.still[v] ? "still" : "others";
        most[kind] = Math.max(most[kind], Math.hypot(texels[4 * v], texels[4 * v + 1], texels[4 * v + 2]));
        if (!surface.still[v]) continue;
        most.count++;
        for (let i = 0; i < 3; i++) most.bones = Math.max(most.bones, surface.joints[3 * v + i]); // 0 is the ground
    }
    return most;
}"""

FRAMED = """async ([asset, spectrum]) => {
    const load = (path) => import(`/web/${path}.js`);
    const [{ Client }, { Stage }, { Tree }, { Points }, { readSurface }] = await Promise.all(
        ["client", "draw/stage", "draw/tree", "draw/points", "draw/surface"].map(load));
    const client = new Client();
    const stage = new Stage(document.createElement("canvas"));
    const tree = new Tree(stage);
    tree.setPoints(new Points(await client.bytes(`/v1/assets/${asset}/points`)));
    tree.setSurface(await readSurface(await client.surface(spectrum)), { hidden: true });
    return [tree.surface.box.max.x, stage.box.max.x];
}"""


@pytest.fixture(scope="module")
def potted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sapling in a pot of terracotta."""
    plant = make_sample(3, "sapling").mesh
    wide = 0.12 * plant.height_m
    mesh, owner = merged(plant, tube([0, 0, 0], [0, 0, POT_M], wide, rings=4, sides=24))
    green, pot = (
        Material(name="plant", base_color=(0.1, 0.3, 0.05, 1.0)),
        Material(name="Pot", base_color=(*TERRACOTTA, 1.0)),
    )
    mesh = replace(
        mesh, look=replace(mesh.look, materials=(green, pot), face_material=owner[mesh.faces[:, 0]].astype(np.int32))
    )
    path = tmp_path_factory.mktemp("pots") / "potted.glb"
    path.write_bytes(written(write_glb, mesh))
    return path


@pytest.fixture(scope="module")
def splat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A green pillar of 3 m, and a red ball beside its foot."""
    rng = np.random.default_rng(0)
    height, angle = rng.uniform(0, 3, 4000), rng.uniform(0, 2 * np.pi, 4000)
    pillar = np.stack([0.15 * np.cos(angle), 0.15 * np.sin(angle), height], axis=1)
    ball = rng.normal(size=(2000, 3))
    ball = 0.3 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [1.0, 0, 0.3]
    colour = np.repeat(np.float32([[0.1, 0.6, 0.1], [0.9, 0.1, 0.1]]), [4000, 2000], axis=0)
    sh = ((colour - 0.5) / np.float32(SH_0))[:, None]
    cloud = cloud_at(np.concatenate([pillar, ball]), scale=0.03, opacity=0.99, sh=sh)
    path = tmp_path_factory.mktemp("splats") / "pillar.ply"
    path.write_bytes(written(write_gaussian_ply, cloud))
    return path


def where_red(viewer: Viewer) -> tuple[dict[str, float], np.ndarray]:
    """The box of the lower red pixels of the stage [px], a little smaller."""
    scrub(viewer, 0.0)
    canvas = viewer.page.locator("#canvas").bounding_box()
    assert canvas
    whole = picture_of(viewer, {"x": 0, "y": 60, "width": 600, "height": canvas["height"] - 160})
    red = (whole[..., 0] - whole[..., 1] > 40) & (whole[..., 0] - whole[..., 2] > 40)
    rows, columns = np.nonzero(red)
    assert len(rows) > 300, "nothing red in the picture"
    top, bottom = np.percentile(rows, [45, 85])  # rows below a pot's rim, over which the stem is seen
    left, right = np.percentile(columns, [15, 85])
    box = {"x": float(left), "y": float(60 + top), "width": float(right - left), "height": float(bottom - top)}
    return box, picture_of(viewer, box)


def stands_still(viewer: Viewer) -> None:
    """Of the red thing: it is the same at two places of the loop."""
    page = viewer.page
    page.locator("#play").click()
    page.locator("#light-section summary").click()
    page.locator("#sun-height").fill("8")  # the shadow of the crown falls beside it
    box, before = where_red(viewer)
    whole = scrub(viewer, 0.0)
    assert changed(whole, scrub(viewer, 0.4)) > 0.002, "the plant does not move"
    assert changed(before, picture_of(viewer, box)) == 0, "it moves"
    assert np.median(np.ptp(before, axis=2)) > 60


def test_the_pot_of_a_mesh_does_not_move(view: Open, url: str, potted: Path) -> None:
    job = job_of(url, potted)
    viewer = view(900, 620)
    viewer.show(f"{url}/#job={job['id']}")
    most = viewer.page.evaluate(DISPLACEMENTS, job["result"]["spectrum_id"])
    assert most["count"] > 90
    assert most["still"] == most["bones"] == 0
    assert most["others"] > 0.005
    stands_still(viewer)


def test_still_gaussians_stand_still_in_the_splat_shader(view: Open, url: str, splat: Path) -> None:
    box = [[0.6, -0.5, -0.1], [1.5, 0.5, 0.7]]
    reading = {"up_axis": "+Z", "unit_m": "1"}
    job = job_of(url, splat, reading=reading, formats=["splat"], still_box_m=box)
    viewer = view(900, 620)
    viewer.show(f"{url}/#job={job['id']}")
    plant, seen = viewer.page.evaluate(FRAMED, [job["asset_id"], job["result"]["spectrum_id"]])
    assert plant < 0.4
    assert seen > 1.2, "the ball is not in the view"
    stands_still(viewer)
