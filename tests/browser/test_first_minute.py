"""The first minute of a stranger: odd names, wrong sizes, broken files, waits. In a real browser."""

import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.render.contact_sheet import STRIP_PX
from tests.browser.conftest import JOB_MS, MOVING, Open, animated, picture_of, web_server
from tests.formats.meshes import written, zipped
from tests.plant import stand

COVERED = "async () => (await (await import('/web/page/early.js')).page).stage.margins.bottom"
EDGES = """async () => {
    await Promise.all([...document.querySelectorAll("#photos img")].map((photo) => photo.decode()));
    return ["#photos img:last-child", "#progress"].map((at) => document.querySelector(at).getBoundingClientRect().y);
}"""
LONG = "a tree whose name does not end " * 7


def named(tree: Path, folder: Path, name: str) -> str:
    path = folder / f"{name}{tree.suffix}"
    path.write_bytes(tree.read_bytes())
    return str(path)


def photos(folder: Path, count: int) -> list[str]:
    paths = [str(folder / f"{n}.jpg") for n in range(count)]
    for path in paths:
        Image.new("RGB", (96, 64)).save(path)
    return paths


@pytest.mark.parametrize(("width", "height", "touch"), [(1280, 800, False), (390, 760, True)])
def test_names_leave_everything_in_its_place(view, url, tree, tmp_path, width, height, touch) -> None:
    viewer = view(width, height, touch=touch)
    page = viewer.page
    page.route("**/v1/assets", lambda route: None)  # it waits for ever
    viewer.open(url)
    for name in (LONG, "שלום עץ", "x" * 200):
        page.set_input_files("#files", named(tree, tmp_path, name))
        expect(page.locator("#progress-title")).to_have_attribute("title", name)
        expect(page.locator("#progress-title")).to_have_attribute("dir", "auto")
        expect(page.locator("#cancel")).to_be_in_viewport(ratio=1)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.locator("#cancel").click()
    page.set_input_files("#files", photos(tmp_path, 24))
    expect(page.locator("#photos img")).to_have_count(24)
    lowest, card = page.evaluate(EDGES)
    assert lowest < card - 40, "photos lie under the card"
    page.evaluate("import('/web/page/progress.js').then((p) => p.showProgress('uploading', { name: 'oak', share: 1 }))")
    expect(page.locator("#stages .running")).to_have_text("Read the files")
    # in software each picture of one takes the job's time
    page.wait_for_function("() => document.getAnimations().length === 0")


def test_what_is_no_tree_is_reported_before_it_is_sent(view: Open, url: str, tree: Path, tmp_path: Path) -> None:
    document = zipped({"[Content_Types].xml": b"<Types/>", "word/document.xml": b"<w/>"}, zipfile.ZIP_STORED)
    contents = {
        "cut.glb": (tree.read_bytes()[:-500], "is cut off after"),
        "zeros.glb": (bytes(200_000), "nothing but zeros"),
        "empty.glb": (b"", "“empty.glb” is empty"),
        "oak.docx": (document, "is a Word document"),
    }
    viewer = view(900, 620)
    page = viewer.page
    sent: list[str] = []
    page.on("request", lambda request: request.method == "POST" and sent.append(request.url))
    viewer.open(url)
    for name, (content, words) in contents.items():
        (tmp_path / name).write_bytes(content)
        page.set_input_files("#files", str(tmp_path / name))
        expect(page.get_by_role("alert")).to_contain_text(words)
        expect(page.locator("#problem-retry")).to_be_hidden()
        expect(page.locator("body")).to_have_attribute("data-state", "welcome")
        page.locator("#problem-close").click()
    assert sent == []


def test_a_tree_that_leaves_takes_its_shadow_along(view: Open, url: str, tmp_path: Path) -> None:
    viewer = view(900, 620)
    viewer.expects = ("422",)
    viewer.open(url)
    viewer.page.wait_for_selector("body[data-live=true]", state="attached")
    viewer.wait_frames(8)
    viewer.page.set_input_files("#files", photos(tmp_path, 3))
    expect(viewer.page.get_by_role("alert")).to_contain_text("3 photos")
    viewer.wait_turns()
    assert picture_of(viewer, {"x": 0, "y": 400, "width": 900, "height": 200}).min() > 190


def test_textures_that_were_not_dropped_are_missed(view: Open, url: str, samples: Path, tmp_path: Path) -> None:
    mesh = read_mesh(io.BytesIO((samples / "mesh/tree-lime.glb").read_bytes()), file_type="glb")
    (tmp_path / "lime.obj").write_bytes(written(write_obj, mesh, library="lime.mtl"))
    (tmp_path / "lime.mtl").write_text(f"newmtl {mesh.look.materials[0].name}\nmap_Kd bark.png\n")
    viewer = view(900, 620)
    viewer.open(url)
    viewer.page.set_input_files("#files", [str(tmp_path / "lime.obj"), str(tmp_path / "lime.mtl")])
    expect(viewer.page.locator("#doubt-words")).to_contain_text("textures")
    viewer.page.locator("#doubt-chips button").click()
    expect(viewer.page.locator("#doubt")).to_be_hidden()


def test_a_doubtful_size_is_mended_by_one_click(view: Open, url: str, tmp_path: Path) -> None:
    mesh = stand.tree(6.0, num_cards=60)
    (tmp_path / "giant.ply").write_bytes(written(write_ply, mesh.with_vertices(mesh.vertices * np.float32(400))))
    viewer = view(900, 620)
    page = viewer.page
    viewer.open(url)
    page.set_input_files("#files", str(tmp_path / "giant.ply"))
    chip = page.locator("#doubt-chips button", has_text="mm: 2.")
    expect(chip).to_be_visible(timeout=JOB_MS)
    with page.expect_response(lambda answer: answer.url.endswith("/v1/assets")) as read:
        chip.click()
    assert read.value.json()["summary"]["source_scale"] == pytest.approx(0.001)
    page.locator("#cancel").click()
    expect(page.locator("#doubt")).to_be_hidden()


def test_the_model_answers_all_winds_while_the_tree_moves(view: Open, url: str, tree: Path) -> None:
    viewer = view(900, 620)
    page, job_id = viewer.page, animated(url, tree, wind={"speed_m_s": 6})
    with page.expect_response(lambda answer: answer.request.method == "POST" and answer.url.endswith("/v1/jobs")):
        viewer.open(f"{url}/#job={job_id}")
    page.locator("#new").click()  # cancels the question, which the next visit asks again
    left: list[str] = []
    page.expose_function("left", lambda state: left.append(str(state)))
    page.goto(f"{url}/#job={job_id}")
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    page.evaluate(
        """new MutationObserver(() => left(document.body.dataset.state))
            .observe(document.body, { attributeFilter: ["data-state"] })"""
    )
    page.locator("#wind-presets button", has_text="Storm").click()
    expect(page.locator("#wind-note")).to_have_text(re.compile(r"motion, \d[\d.]* times as far"), timeout=JOB_MS)
    assert left == [], "the tree went away meanwhile"
    with page.expect_response(re.compile("/v1/artifacts/")) as still:
        page.locator("#open-jobs").click()
    assert len(still.value.body()) < 20_000, "ten of a list are to be small"
    assert "Spectrum" not in page.locator("#job-list").inner_text()


def test_the_card_of_a_job_grows_beside_the_tree(view: Open, url: str, tree: Path) -> None:
    viewer = view(900, 620)
    page = viewer.page
    page.route("**/v1/spectra/*/modes*", lambda route: None)  # it waits for ever
    viewer.open(url)
    page.set_input_files("#files", str(tree))
    expect(page.locator("#stages")).to_contain_text("Draw the tree in motion")
    viewer.wait_turns()
    card = page.locator("#progress").bounding_box()
    assert card
    assert page.evaluate(COVERED) >= 620 - card["y"], "it lies over the tree"


def test_an_opened_job_shows_its_still_and_says_what_it_waits_for(view: Open, url: str, job_id: str) -> None:
    page = view(900, 620).page
    waiting: list[object] = []
    page.route("**/v1/spectra/*/modes*", lambda route: waiting.append(route) or None)
    page.goto(f"{url}/#job={job_id}")
    expect(page.locator("#poster")).to_be_visible()
    assert page.evaluate("[poster.naturalWidth, poster.naturalHeight]") == [*STRIP_PX]
    expect(page.locator("#stages")).to_contain_text("Draw the tree in motion")
    for route in waiting:
        route.continue_()  # type: ignore[attr-defined]
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    expect(page.locator("#poster")).to_be_hidden()
    page.unroute_all()
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url.removeprefix(url)))
    page.reload()
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    spectra = [path for path in sent if path.startswith("/v1/spectra/")]
    assert len(set(spectra)) == len(spectra)
    assert not any(path.startswith("/v1/artifacts/") for path in sent), "a still's file is as large as the motion"


def test_formats_that_were_asked_for_are_there_again(view: Open, url: str, job_id: str) -> None:
    viewer = view(900, 620)
    page = viewer.page
    viewer.show(f"{url}/#job={job_id}")
    expect(page.locator("#artifacts")).to_contain_text("Animated GLB")
    page.locator("#more summary").click()
    page.locator("#more-formats button", has_text="Motion").click()
    expect(page.locator("#artifacts")).to_contain_text("Motion, every frame", timeout=JOB_MS)
    page.reload()
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    expect(page.locator("#artifacts")).to_contain_text("Motion, every frame")


def test_a_kit_for_the_web_stands_on_any_server(view: Open, url: str, job_id: str, tmp_path: Path) -> None:
    viewer = view(900, 620)
    page = viewer.page
    viewer.show(f"{url}/#job={job_id}")
    page.locator("#download").click()
    with page.expect_download() as blender:
        page.locator("#kit-list button", has_text="Blender").click()
    with zipfile.ZipFile(blender.value.path()) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == ["README.txt", "tree.glb"]
        assert archive.read("tree.glb")[:4] == b"glTF"
    with page.expect_download() as web:
        page.locator("#kit-list button", has_text="Web").click()
    assert web.value.suggested_filename == "sapling-web.zip"
    with zipfile.ZipFile(web.value.path()) as archive:
        archive.extractall(tmp_path / "any" / "folder")
    with web_server(tmp_path / "any") as origin:
        alone = view(700, 500)
        alone.page.goto(f"{origin}/folder/")
        alone.page.wait_for_selector(MOVING, state="attached")
        alone.wait_frames(4)
