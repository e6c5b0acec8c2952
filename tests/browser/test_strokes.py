"""Strokes on the photos of a real reconstruction cut out the plant, by mouse and by touch."""

import io

import httpx
import pytest
from playwright.sync_api import Page, expect

from dynamictree.formats.splat.ply import read_gaussian_ply
from tests.browser.conftest import JOB_MS, MOVING, Open, job_of, press
from tests.reconstruct.conftest import photographed

pytestmark = pytest.mark.timeout(1800)

LONGEST_MS = 6 * JOB_MS
PARAMS = {"formats": ["splat"], "num_steps": 1, "splat_steps": 100, "height_m": 1.2}


@pytest.fixture(scope="module")
def photos_job(url: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A job that has reconstructed a stump in a blue pot from fourteen small photos, and given it motion."""
    orbit = photographed(tmp_path_factory.mktemp("photos"), potted=True)
    return str(job_of(url, *orbit.photos, **PARAMS)["id"])


def place(page: Page, x: float, y: float) -> tuple[float, float]:
    """Where a share of the photo's width and height is in the window."""
    box = page.locator("#strokes-photo").bounding_box()
    assert box
    return box["x"] + x * box["width"], box["y"] + y * box["height"]


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*place(page, *start))
    page.mouse.down()
    page.mouse.move(*place(page, *end), steps=8)
    page.mouse.up()


def swipe(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    """A finger on the screen: the browser makes pointer events of touches."""
    (x, y), (right, down) = place(page, *start), place(page, *end)
    move, lift = press(page, x, y, touch=True)
    for step in range(1, 9):
        move(x + step / 8 * (right - x), y + step / 8 * (down - y))
    lift()


def blue_gaussians(url: str, job_id: str) -> int:
    """How many Gaussians of the plant have the colour of the pot."""
    listed = httpx.get(f"{url}/v1/jobs/{job_id}/artifacts", timeout=60).json()["artifacts"]
    address = next(artifact["url"] for artifact in listed if artifact["name"] == "splat.ply")
    red, _, blue = read_gaussian_ply(io.BytesIO(httpx.get(url + address, timeout=60).content)).sh[:, 0].T
    return int((blue > red).sum())


@pytest.mark.parametrize(("width", "height", "scheme"), [(1100, 720, "light"), (390, 760, "dark")])
def test_a_drag_on_a_photo_cuts_out_the_plant(view, url, photos_job, axe, width, height, scheme) -> None:
    touch = width < 800
    viewer = view(width, height, scheme=scheme, touch=touch)
    page, draw = viewer.page, swipe if touch else drag
    viewer.open(f"{url}/#job={photos_job}")
    page.wait_for_selector(MOVING, state="attached", timeout=LONGEST_MS)
    page.locator("#mark-plant").click()
    expect(page.locator("#strokes-nth")).to_have_text("Photo 1 of 14 · strokes: 0")
    expect(page.locator("#strokes-undo")).to_be_disabled()
    assert page.locator("#strokes-whole").is_hidden()
    draw(page, (0.5, 0.22), (0.5, 0.42))
    page.locator("#strokes-kind input[value=other]").check(force=True)
    draw(page, (0.38, 0.68), (0.6, 0.7))
    expect(page.locator("#strokes-nth")).to_have_text("Photo 1 of 14 · strokes: 2")
    draw(page, (0.1, 0.1), (0.9, 0.1))
    page.locator("#strokes-undo").click()
    expect(page.locator("#strokes-nth")).to_have_text("Photo 1 of 14 · strokes: 2")
    assert axe(page) == [], "strokes"
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.locator("#strokes-photo").focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Space")
    expect(page.locator("#strokes-nth")).to_have_text("Photo 1 of 14 · strokes: 3")
    page.locator("#strokes-undo").click()
    for number in range(2, 11):
        page.locator("#strokes-next").click()
        expect(page.locator("#strokes-nth")).to_have_text(f"Photo {number} of 14 · strokes: 0")
        if number in (6, 10):
            draw(page, (0.4, 0.7), (0.6, 0.7))  # other sides of the pot
    with page.expect_request(lambda request: request.method == "POST" and request.url.endswith("/v1/jobs")) as sent:
        page.locator("#strokes-cut").click()
    plant, *others = sent.value.post_data_json["params"]["scribbles"]
    assert [plant["plant"], *(other["plant"] for other in others)] == [True, False, False, False]
    assert [plant["photo"], *(other["photo"] for other in others)] == [f"photo_{n:02d}.jpg" for n in (0, 0, 5, 9)]
    assert len(plant["points"]) > 4
    assert max(abs(x - 0.5) for x, _ in plant["points"]) < 0.01
    assert (plant["points"][0][1], plant["points"][-1][1]) == pytest.approx((0.22, 0.42), abs=0.02)
    expect(page.locator("body")).not_to_have_attribute("data-state", "moving")
    page.wait_for_selector(MOVING, state="attached", timeout=LONGEST_MS)
    cut = page.url.partition("#job=")[2]
    assert cut != photos_job
    expect(page.locator("#artifacts a", has_text="Animated splat")).to_be_attached(timeout=LONGEST_MS)
    assert blue_gaussians(url, cut) < 0.2 * blue_gaussians(url, photos_job), "the pot is still there"
    page.locator("#mark-plant").click()
    expect(page.locator("#strokes-nth")).to_have_text("Photo 1 of 14 · strokes: 2")
    with page.expect_request(lambda request: request.method == "POST" and request.url.endswith("/v1/jobs")) as sent:
        page.locator("#strokes-whole").click()
    assert sent.value.post_data_json["params"]["scribbles"] is None


def test_a_tree_that_is_no_photos_offers_no_strokes(view: Open, url: str, job_id: str) -> None:
    viewer = view(900, 620)
    viewer.show(f"{url}/#job={job_id}")
    expect(viewer.page.locator("#apply-tree")).to_be_attached()
    assert viewer.page.locator("#plant-section").is_hidden()
