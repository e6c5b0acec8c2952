"""What is dropped is drawn at once, from the file itself: the service has not got a byte of it."""

import io
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import expect

from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import read_gaussian_ply, write_gaussian_ply
from dynamictree.mesh import Material, MeshLook, TriangleMesh
from lab.dataset.sample import make_sample
from tests.browser.conftest import Open, changed, pixels
from tests.clouds import cloud_at
from tests.formats.meshes import written

GREEN = (0.07, 0.12, 0.05, 1.0)
"""Linear."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One sapling in every format, and a splat."""
    mesh, folder = make_sample(3, "sapling").mesh, tmp_path_factory.mktemp("dropped")
    paths = {kind: folder / f"tree.{kind}" for kind in ("glb", "obj", "stl", "ply", "xyz", "las", "laz")}
    paths["splat"] = folder / "splat.ply"
    paths["glb"].write_bytes(written(write_glb, mesh))
    paths["ply"].write_bytes(written(write_ply, mesh))
    bare = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    bare.export(paths["stl"])
    bare.vertices = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]  # +Y up, as OBJ is
    bare.export(paths["obj"])
    scanned = mesh.vertices + np.array([512_000.0, 5_400_000.0, 310.0])  # as a surveyor's coordinates
    paths["xyz"].write_text("X Y Z\n" + "\n".join(f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in scanned))
    scan = laspy.create(point_format=7, file_version="1.4")
    scan.header.scales, scan.header.offsets = [1e-3] * 3, [512_000.0, 5_400_000.0, 310.0]
    scan.x, scan.y, scan.z = scanned.T
    scan.red, scan.green, scan.blue = np.tile(np.uint16([[20_000], [40_000], [10_000]]), len(scanned))
    scan.write(paths["las"])
    scan.write(paths["laz"])
    rng = np.random.default_rng(0)
    cloud = cloud_at(rng.uniform([-0.3, -1.5, -0.3], [0.3, 1.5, 0.3], (3000, 3)), scale=0.05, opacity=0.99)
    paths["splat"].write_bytes(written(write_gaussian_ply, cloud))
    return paths


SIZE_OF_DRAFT = """async () => {
    const { draft } = (await (await import("/web/page/early.js")).page).scene;
    return draft && draft.box.max.clone().sub(draft.box.min).toArray();
}"""


@pytest.mark.parametrize("kind", ["glb", "obj", "stl", "ply", "xyz", "las", "laz", "splat"])
def test_it_is_drawn_while_its_upload_has_not_begun(view: Open, url: str, files: dict[str, Path], kind: str) -> None:
    viewer = view(900, 620)
    page = viewer.page
    page.route("**/v1/assets", lambda route: None)  # it waits for ever
    page.route("**/web/examples/*.safetensors", lambda route: route.abort())  # no live tree
    viewer.open(url)
    page.locator("#welcome").evaluate("(node) => { node.style.visibility = 'hidden'; }")
    empty = pixels(viewer)
    page.set_input_files("#files", str(files[kind]))
    expect(page.locator("body")).to_have_attribute("data-state", "uploading")
    if kind != "splat":  # its file states no size
        high = make_sample(3, "sapling").mesh.height_m
        expect(page.locator("#height-note")).to_contain_text(f"{high:.1f} m high; the person is 1.8 m")
    for _ in range(120):
        if changed(empty, pixels(viewer)) > 0.01:
            break
        page.wait_for_timeout(500)
    assert changed(empty, pixels(viewer)) > 0.01, "nothing is drawn"
    page.locator("#cancel").click()
    expect(page.locator("#height-note")).to_have_text("")
    viewer.expects = ("Failed to load resource",)


# The size of the stage in each frame, and whether its shadow is drawn anew
RARE_SHADOWS = """async () => {
    const { Stage } = await import("/web/draw/stage.js"), { _render } = Stage.prototype;
    window.drawn = [];
    Stage.prototype._render = function (scale, shadow) {
        drawn.push([this.radius, shadow]);
        this.resolution.frame = 0; // with the fewest pixels, which software has, the next shadow comes in four frames
        return _render.call(this, scale, shadow);
    };
}"""


@pytest.mark.parametrize("up_axis", ["-Y", "+Z"])
def test_a_splat_stands_as_its_file_says(view, url, files, tmp_path, up_axis) -> None:
    lying = read_gaussian_ply(io.BytesIO(files["splat"].read_bytes()))
    tall = replace(lying, means=lying.means[:, [0, 2, 1]], source=replace(lying.source, up_axis=up_axis))
    (tmp_path / "tall.ply").write_bytes(written(write_gaussian_ply, tall))
    viewer = view(640, 480)
    viewer.page.route("**/v1/assets", lambda route: None)  # it waits for ever
    viewer.open(url)
    viewer.page.evaluate(RARE_SHADOWS)
    viewer.wait_frames(1)
    viewer.page.set_input_files("#files", str(tmp_path / "tall.ply"))
    while not (size := viewer.page.evaluate(SIZE_OF_DRAFT)):
        viewer.page.wait_for_timeout(200)
    assert size[2] > 3 * max(size[:2])
    viewer.page.wait_for_function(
        "() => drawn.some(([radius]) => radius !== drawn[0][0])"
    )  # not yet where turns are slow
    drawn = viewer.page.evaluate("drawn")
    assert next(shadow for radius, shadow in drawn if radius != drawn[0][0]), "the welcome's shadow lies there"


def test_an_obj_has_the_colours_of_the_same_mesh_as_glb(view: Open, url: str, tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=2)
    mesh = TriangleMesh(
        vertices=np.float32(ball.vertices),
        faces=np.int32(ball.faces),
        look=MeshLook(materials=(Material(base_color=GREEN),)),
    )
    with (tmp_path / "ball.obj").open("wb") as stream:
        [library] = write_obj(mesh, stream, library="ball.mtl").values()
    (tmp_path / "ball.mtl").write_bytes(library + b"Ks 0.5 0.5 0.5\nNs 96\n")  # as Blender writes
    (tmp_path / "ball.glb").write_bytes(written(write_glb, mesh))
    for texture in ("bark.png", "leaf.png"):
        Image.new("RGB", (8, 8)).save(tmp_path / texture)
    seen = []
    for names in (("ball.glb",), ("ball.obj", "ball.mtl", "bark.png", "leaf.png")):
        viewer = view(900, 620)
        viewer.page.route("**/v1/assets", lambda route: None)  # it waits for ever
        viewer.open(url)
        viewer.page.set_input_files("#files", [str(tmp_path / name) for name in names])
        expect(viewer.page.locator("#height-note")).to_contain_text("4.0 m high")
        viewer.wait_turns()
        viewer.wait_sharp()
        seen.append(pixels(viewer))
        assert viewer.page.locator("#photos img").count() == 0, "textures are no photos"
    assert changed(*seen) < 0.005


WATCH_PERSON = """async () => {
    const { Person } = await import("/web/draw/person.js");
    const { show } = Person.prototype;
    Person.prototype.show = function (...how) { window.person = this; show.apply(this, how); };
}"""

PERSON_PX = """() => {
    const { mesh, stage } = window.person, { x, y, z } = mesh.position, half = 0.165 * mesh.scale.x;
    return [...[-half, half].map((d) => stage.onScreen([x + d, y, z]).x), stage.onScreen([x, y, z + mesh.scale.x]).y];
}"""


@pytest.mark.parametrize(("width", "height"), [(390, 760), (1100, 720)])
@pytest.mark.parametrize("kind", ["wide", "small"])
def test_the_whole_person_is_seen_beside_a_wide_tree_and_a_plant_of_one_metre(
    view: Open, url: str, samples: Path, tmp_path: Path, kind: str, width: int, height: int
) -> None:
    file, note = samples / "mesh/tree-lime.glb", "the person is"
    if kind == "small":
        file, note, mesh = tmp_path / "small.glb", "1.0 m high", make_sample(3, "sapling").mesh
        file.write_bytes(written(write_glb, mesh.with_vertices(mesh.vertices / mesh.height_m)))
    page = (viewer := view(width, height)).page
    page.route("**/v1/assets", lambda route: None)  # it waits for ever
    viewer.open(url)
    page.evaluate(WATCH_PERSON)
    page.set_input_files("#files", str(file))
    expect(page.locator("#height-note")).to_contain_text(note)
    left, right, top = page.evaluate(PERSON_PX)
    assert (0.5 * width if kind == "wide" else 0) < left < right < width
    assert kind == "wide" or 0 < top < height
