"""The viewer as people use it, in a real browser against a real service."""

import re
from contextlib import closing
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from dynamictree.formats.splat.ply import write_gaussian_ply
from jobs.clients.keys import create_key
from jobs.store import Store
from tests.browser.conftest import JOB_MS, MOVING, Open, Viewer, animated, changed, pixels, scrub, steady
from tests.clouds import cloud_at
from tests.formats.meshes import written
from tests.servers import api

AHEAD_RAD, LEVEL, KEY_RAD = np.arctan2(1, 0.38), np.hypot(1, 0.38) / np.linalg.norm([1, 0.38, 0.2]), 0.12
"""Where the camera looks at first, the level part of that, and how far an arrow key turns it: web/draw/stage.js."""
Y_1, LOPSIDED = 0.4886025, 0.8  # the harmonics of degree 1, and a coefficient
SMALL_BUTTONS = """() => [...document.querySelectorAll("button")]
    .filter((button) => button.checkVisibility() && button.offsetHeight < 40)
    .map((button) => button.id)"""
NAMELESS = """() => [...document.querySelectorAll("button, input, a, canvas, summary")]
    .filter((node) => node.checkVisibility() && node.type !== "file")
    .filter((node) => !(node.getAttribute("aria-label") || node.labels?.length || node.textContent.trim()))
    .map((node) => node.outerHTML)"""


def on_the_tree(viewer: Viewer) -> tuple[float, float]:
    """A place where the pointer says that it can take hold: the first on the way down to the crown."""
    box = viewer.page.locator("#canvas").bounding_box()
    panel = viewer.page.locator("#panel").bounding_box()
    assert box
    assert panel
    free = panel["x"] if panel["x"] > 100 else box["width"]  # on a phone the panel lies below
    for x in np.linspace(0.5, 0.44, 3) * free:
        for y in range(70, int(box["height"]) - 180, 12):
            viewer.page.mouse.move(x, y)
            if "over" in (viewer.page.locator("#canvas").get_attribute("class") or ""):
                return float(x), float(y + 10)
    raise AssertionError("the pointer is nowhere on the tree")


@pytest.fixture(scope="module")
def job_url(url: str, tree: Path) -> str:
    """The page with a tree whose job has ended."""
    return f"{url}/#job={animated(url, tree)}"


def test_a_tree_is_given_moves_and_answers_a_pull(view: Open, url: str, tree: Path) -> None:
    viewer = view(900, 620)
    page = viewer.page
    viewer.open(url)
    expect(page.get_by_role("heading", name="Give a tree. See it move.")).to_be_visible()
    page.set_input_files("#files", str(tree))
    expect(page.locator("#stages li")).not_to_have_count(0)
    seen = page.locator("#stages").inner_text()
    page.wait_for_selector(MOVING, timeout=JOB_MS)
    assert re.search("Upload|Find the voxels|Generate the motion", seen)
    expect(page.locator("#caption")).to_contain_text("sapling")
    expect(page.locator("#artifacts")).to_contain_text("Animated GLB", timeout=JOB_MS)
    link = page.locator("#artifacts a", has_text="Animated GLB")
    assert httpx.get(url + str(link.get_attribute("href")), timeout=60).content[:4] == b"glTF"

    moving = pixels(viewer)
    viewer.wait_frames(4)
    assert changed(moving, pixels(viewer)) > 0.002, "nothing moves"

    page.locator("#play").click()
    steady(viewer)  # the wind has risen
    first = scrub(viewer, 0.0)
    assert changed(first, scrub(viewer, 0.4)) > 0.002
    assert changed(first, scrub(viewer, 1.0)) == 0, "the loop does not close"

    page.locator("#damping").fill("50")
    x, y = on_the_tree(viewer)
    page.mouse.down()
    page.mouse.move(x + 40, y)
    page.mouse.move(x + 90, y + 10)
    expect(page.locator("#grip")).to_be_visible()
    viewer.wait_frames(8)
    assert changed(first, pixels(viewer)) > 0.004, "the branch does not follow"
    page.mouse.up()
    expect(page.locator("#grip")).to_be_hidden()
    page.mouse.move(5, 300)
    assert changed(first, steady(viewer)) < 0.0005, "the branch does not come back"


def test_views_wind_and_the_tree_at_rest_change_the_picture(view: Open, job_url: str) -> None:
    viewer = view(900, 620, scheme="dark")
    page = viewer.page
    viewer.show(job_url)
    page.locator("#play").click()
    steady(viewer)
    before = scrub(viewer, 0.0)
    for name in ("wire", "voxels", "modes"):
        page.locator(f"#views input[value={name}]").check(force=True)
        viewer.wait_turns()
        page.wait_for_timeout(600)
        assert changed(before, pixels(viewer)) > 0.01, name
    expect(page.locator("#mode-out")).to_contain_text("0.24 Hz")
    page.locator("#views input[value=surface]").check(force=True)
    page.locator("#rest").check()
    page.wait_for_timeout(800)
    assert changed(before, pixels(viewer)) > 0.002
    page.locator("#rest").uncheck()
    page.locator("#speed").fill("0")
    expect(page.locator("#wind-note")).to_contain_text("No wind")
    page.locator("#speed").fill("14")
    expect(page.locator("#wind-note")).to_contain_text("times as far")
    expect(page.locator("#make-wind")).to_be_visible()
    page.wait_for_timeout(3000)
    assert changed(before, pixels(viewer)) > 0.005
    page.locator("#wind-endless").check(force=True)
    expect(page.locator("#time")).to_be_disabled()
    page.locator("#play").click()
    expect(page.locator("#clock")).to_have_text(re.compile(r"^([5-9]|\d\d)\.\d s$"))  # the loop has 4.17 s
    page.locator("#play").click()
    assert changed(before, pixels(viewer)) > 0.005
    page.locator("#wind-modes input[value=loop]").check(force=True)
    expect(page.locator("#time")).to_be_enabled()


def test_on_a_phone_everything_is_within_reach(view: Open, job_url: str) -> None:
    viewer = view(390, 760, touch=True)
    page = viewer.page
    viewer.open(job_url.partition("#")[0])
    viewer.page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.goto(job_url)  # only the hash changes: a link pasted into the open page
    page.wait_for_selector(MOVING, timeout=JOB_MS)
    viewer.wait_frames(3)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    for name in ("#speed", "#damping", "#download"):
        page.locator(name).first.scroll_into_view_if_needed()
        expect(page.locator(name).first).to_be_in_viewport()
    assert page.evaluate(SMALL_BUTTONS) == [], "too small for a finger"


def test_the_keyboard_is_enough(view: Open, job_url: str) -> None:
    viewer = view(900, 620)
    page = viewer.page
    viewer.show(job_url)
    page.locator("#canvas").focus()
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")
    before = steady(viewer)
    page.keyboard.press("ArrowLeft")
    viewer.wait_turns()
    viewer.wait_sharp()
    assert changed(before, pixels(viewer)) > 0.01
    assert page.evaluate(NAMELESS) == [], "these have no name"
    page.locator("#open-jobs").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#job-list li").first).to_contain_text("sapling")
    page.keyboard.press("Escape")
    expect(page.locator("#jobs")).to_be_hidden()


def test_an_error_is_shown_as_the_service_tells_it(view: Open, url: str, tmp_path: Path) -> None:
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"glTF but not really")
    problem = httpx.post(f"{url}/v1/assets", files={"file": (broken.name, broken.read_bytes())}, timeout=60).json()
    viewer = view(700, 560)
    viewer.open(url)
    viewer.page.set_input_files("#files", str(broken))
    alert = viewer.page.get_by_role("alert")
    expect(alert).to_contain_text(problem["title"])
    expect(alert).to_contain_text(problem["detail"])
    expect(alert).to_contain_text(problem["suggestion"])
    viewer.page.keyboard.press("Escape")
    expect(alert).to_be_hidden()
    viewer.expects = ("Failed to load resource",)


@pytest.fixture(scope="module")
def two_faced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pillar of Gaussians that all are red seen from the north, green from the east, and grey in between."""
    rng = np.random.default_rng(0)
    height, angle = rng.uniform(0, 3, 6000), rng.uniform(0, 2 * np.pi, 6000)
    radius = 0.4 * np.sqrt(np.clip(1 - (np.abs(height - 1.5) / 1.5) ** 8, 0, 1))
    sh = np.zeros((6000, 4, 3), np.float32)
    sh[:, 1, 0] = sh[:, 3, 1] = LOPSIDED
    means = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    path = tmp_path_factory.mktemp("splats") / "pillar.ply"
    path.write_bytes(written(write_gaussian_ply, cloud_at(means, scale=0.04, opacity=0.99, sh=sh)))
    return path


OF_ANOTHER = """async () => {
    const { hand } = await (await import("/web/page/early.js")).page;
    for (const end = Date.now() + 300_000; !hand.tree?.splat; await new Promise(requestAnimationFrame))
        if (Date.now() > end) throw new Error("no splat came");
    return Object.create(hand.tree.splat, { renderer: { value: { activeSplats: 9, display: { mapping: [] } } } }).drawn;
}"""


def test_a_splat_is_drawn_in_the_colours_of_the_side_that_is_seen(view: Open, url: str, two_faced: Path) -> None:
    job = animated(url, two_faced, reading={"up_axis": "+Z"}, formats=["splat"])
    viewer = view(900, 620)
    page = viewer.page
    viewer.show(f"{url}/#job={job}")
    expect(page.locator("#artifacts")).to_contain_text("Animated splat", timeout=JOB_MS)
    assert not page.evaluate(OF_ANOTHER), "what was dropped may be sorted when this one is there already"
    page.locator("#speed").fill("0")  # without wind nothing has turned
    page.locator("#canvas").focus()
    angle = AHEAD_RAD
    for turns in (0, 9, 22):
        for _ in range(turns):
            page.keyboard.press("ArrowLeft")
        picture = steady(viewer)
        height, width = np.array(picture.shape[:2]) // 2
        middle = np.median(picture[height - 15 : height + 15, width - 8 : width + 8], axis=(0, 1)) / 255
        angle -= turns * KEY_RAD
        ahead = np.array([np.cos(angle), np.sin(angle)]) * LEVEL
        expected = [0.5 - Y_1 * LOPSIDED * ahead[1], 0.5 - Y_1 * LOPSIDED * ahead[0], 0.5]
        np.testing.assert_allclose(middle, expected, atol=0.04)


def test_a_key_is_asked_for_where_one_is_needed(view: Open, tmp_path: Path) -> None:
    state = tmp_path / "state"
    state.mkdir()
    with closing(Store.open(f"sqlite:///{state.resolve() / 'jobs.sqlite'}")) as store:
        _, key = create_key(store, name="page")
    server, url = api(tmp_path, {"DYNAMICTREE_STATE_DIR": str(state), "DYNAMICTREE_KEYS": "required"})
    server.start()
    try:
        viewer = view(700, 560)
        page, viewer.expects = viewer.page, ("401",)
        viewer.open(url)
        expect(page.locator("#key-dialog")).to_be_hidden()
        page.locator("#open-jobs").click()
        page.locator("#key").fill(key)
        page.locator("#key-dialog button[value=ok]").click()
        expect(page.locator("#no-jobs")).to_be_visible()
    finally:
        server.stop()
