"""The tree behind the welcome: it moves before anything is uploaded, in a real browser."""

import httpx
import pytest
from playwright.sync_api import expect

from tests.browser.conftest import Open, Viewer, changed, picture_of

LIVE = "body[data-live=true]"


@pytest.mark.parametrize(("width", "height", "scheme"), [(1100, 720, "light"), (390, 760, "dark")])
def test_a_tree_sways_and_answers_a_pull_before_any_upload(view, url, width, height, scheme) -> None:
    viewer = view(width, height, scheme=scheme)
    page = viewer.page
    before = httpx.get(f"{url}/v1/jobs", timeout=60).json()["data"]
    viewer.open(url)
    page.wait_for_selector(LIVE, state="attached")
    viewer.wait_frames(2)
    still = picture_of(viewer, free_part(viewer))
    viewer.wait_frames(6)
    assert changed(still, picture_of(viewer, free_part(viewer))) > 0.001, "nothing sways"
    page.keyboard.press("Space")  # no wind from here on
    viewer.wait_turns(5)
    still = picture_of(viewer, free_part(viewer))
    x, y = place_on_the_tree(viewer)
    page.mouse.down()
    page.mouse.move(x + 20, y)
    page.mouse.move(x + 60, y + 6)
    expect(page.locator("#grip")).to_be_visible()
    viewer.wait_frames(6)
    assert changed(still, picture_of(viewer, free_part(viewer))) > 0.004, "the branch does not follow"
    page.mouse.up()
    expect(page.locator("#grip")).to_be_hidden()
    viewer.wait_sharp()
    assert httpx.get(f"{url}/v1/jobs", timeout=60).json()["data"] == before


GAPS = """async () => {
    const { hand, stage } = await (await import("/web/page/early.js")).page;
    const { gripNow } = await import("/web/motion/grip.js");
    return hand.pulls.filter(({ grip }) => grip).map(({ grip: { place, target } }) => {
        const [at, wanted] = [gripNow(hand.tree, place), target].map((point) => stage.onScreen(point));
        return Math.hypot(at.x - wanted.x, at.y - wanted.y);
    });
}"""


def test_with_shift_a_place_stays_and_another_is_pulled(view: Open, url: str) -> None:
    viewer = view(1100, 720)
    page = viewer.page
    viewer.open(url)
    page.wait_for_selector(LIVE, state="attached")
    page.keyboard.press("Space")  # no wind from here on
    for share, (right, down) in ((0.45, (10, 30)), (0.55, (-20, 20))):
        x, y = place_on_the_tree(viewer, share)
        page.mouse.down()
        page.mouse.move(x + right / 2, y + down / 2)
        page.mouse.move(x + right, y + down)
        viewer.wait_frames(6)
        if share < 0.5:
            page.keyboard.down("Shift")
            page.mouse.up()
            page.keyboard.up("Shift")
    expect(page.locator(".grip:visible")).to_have_count(2)
    page.wait_for_timeout(1500)
    gaps = page.evaluate(GAPS)
    assert len(gaps) == 2
    assert max(gaps) < 1, "px"
    page.mouse.up()
    expect(page.locator(".grip:visible")).to_have_count(0)


def test_the_tree_is_there_again_after_another(view: Open, url: str) -> None:
    viewer = view(900, 620)
    viewer.expects = ("404",)
    viewer.open(f"{url}/#job=01ARZ3NDEKTSV4RRFFQ69G5FAV")
    alert = viewer.page.get_by_role("alert")
    expect(alert).to_be_visible()
    assert viewer.page.locator(LIVE).count() == 0, "the welcome's tree stands behind a job"
    alert.get_by_role("button", name="Close").click()
    viewer.page.wait_for_selector(LIVE, state="attached")
    viewer.wait_frames(2)


def free_part(viewer: Viewer) -> dict[str, float]:
    """The part of the window where the tree stands: beside the welcome, or above it."""
    size = viewer.page.viewport_size
    words = viewer.page.locator("#welcome").bounding_box()
    title = viewer.page.locator("#welcome h2").bounding_box()
    assert size
    assert words
    assert title
    left = words["width"] if words["width"] < 0.9 * size["width"] else 0
    bottom = size["height"] if left else title["y"]
    return {"x": left, "y": 60, "width": size["width"] - left, "height": bottom - 60}


def place_on_the_tree(viewer: Viewer, share: float = 0.5) -> tuple[float, float]:
    """The first place on the way down where the pointer says that it can take hold."""
    part = free_part(viewer)
    x = part["x"] + share * part["width"]
    for y in range(int(part["y"]), int(part["y"] + part["height"]), 8):
        viewer.page.mouse.move(x, y)
        if "over" in (viewer.page.locator("#canvas").get_attribute("class") or ""):
            viewer.page.mouse.move(x, y + 8)
            return x, float(y + 8)
    raise AssertionError("the pointer is nowhere on the tree")
