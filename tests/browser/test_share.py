"""A tree on a page of another origin, and the view as picture and video, in a real browser."""

import base64
import io
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from jobs.clients.keys import create_key
from jobs.store import Store
from recipes.demo import serve
from tests.browser.conftest import JOB_MS, MOVING, PICTURES, Open, animated, web_server

FRAMES = """async ([base64, times]) => {
    const bytes = Uint8Array.from(atob(base64), (sign) => sign.charCodeAt(0));
    const video = Object.assign(document.createElement("video"), { muted: true });
    video.src = URL.createObjectURL(new Blob([bytes], { type: "video/webm" }));
    await new Promise((done, fail) => { video.onloadeddata = done; video.onerror = () => fail(video.error); });
    const canvas = Object.assign(document.createElement("canvas"), { width: 160, height: 120 });
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    const pictures = [];
    for (const share of times) {
        await new Promise((done) => { video.onseeked = done; video.currentTime = share * video.duration; });
        await new Promise((done) => setTimeout(done, 500)); // until the frame is there to be drawn
        pen.drawImage(video, 0, 0, 160, 120);
        pictures.push(Array.from(pen.getImageData(0, 0, 160, 120).data));
    }
    return [video.duration, video.videoWidth, video.videoHeight, pictures];
}"""


@dataclass(frozen=True, kw_only=True)
class Site:
    """A page of another origin."""

    folder: Path
    origin: str

    def write(self, body: str) -> str:
        """Put a page there; gives its address."""
        (self.folder / "page.html").write_text(f"<!doctype html><title>A forest</title>{body}")
        return f"{self.origin}/page.html"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("site")
    with web_server(folder) as origin:
        yield Site(folder=folder, origin=origin)


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory, site: Site) -> Iterator[tuple[str, str]]:
    """A service that wants keys and lets the site embed its trees; and a key."""
    folder = tmp_path_factory.mktemp("locked")
    with ExitStack() as stack:
        with pytest.MonkeyPatch.context() as patch:  # other services start without it
            patch.setenv("DYNAMICTREE_KEYS", "required")
            patch.setenv("DYNAMICTREE_EMBED_ORIGINS", f'["{site.origin}"]')
            url = stack.enter_context(serve(folder / "state", folder / "serve.log"))
        with closing(Store.open(f"sqlite:///{folder / 'state' / 'jobs.sqlite'}")) as store:
            key = create_key(store, name="page")[1]
        yield url, key


def frame_of(page: Page) -> Page:
    """The element's frame once its tree moves."""
    page.wait_for_selector("dynamic-tree[data-state=moving]", state="attached", timeout=JOB_MS)
    [frame] = [frame for frame in page.frames if "/embed" in frame.url]
    return frame  # type: ignore[return-value]


def test_a_page_of_another_origin_shows_a_tree_of_a_service_with_keys(view, browser, locked, site, tree) -> None:
    url, key = locked
    job_id = animated(url, tree, key=key)
    viewer = view(900, 620)
    page = viewer.page
    viewer.open(url)
    page.evaluate("(key) => sessionStorage.setItem('key', key)", key)
    page.goto(f"{url}/#job={job_id}")
    page.reload()
    page.wait_for_selector(MOVING, timeout=JOB_MS)
    page.locator("#share").click()
    expect(page.locator("#share-note")).to_contain_text("The code works until")
    code = page.locator("#share-embed").input_value()
    assert key not in code
    page.goto("about:blank")

    page.set_viewport_size({"width": 700, "height": 560})
    page.goto(site.write(f"<h1>Our birch</h1>{code}"))
    frame = frame_of(page)
    page.wait_for_timeout(1000)
    before = int(frame.evaluate("document.body.dataset.frames"))
    page.wait_for_timeout(3000)
    assert int(frame.evaluate("document.body.dataset.frames")) > before, "nothing sways"
    assert frame.evaluate("try { parent.document.title } catch (error) { error.name }") == "SecurityError"
    viewer.expects = ("Failed to load resource",)


def test_other_sites_get_no_frame(view: Open, url: str, site: Site) -> None:
    viewer = view(700, 560)
    viewer.expects = ("frame-ancestors",)
    viewer.page.goto(site.write(f"<iframe src='{url}/embed'></iframe><iframe src='{url}/'></iframe>"))
    for _ in range(60):
        if len(viewer.complaints) == 2:
            return
        viewer.page.wait_for_timeout(500)
    raise AssertionError(viewer.complaints)


def test_the_example_stands_in_a_transparent_frame(view: Open, url: str) -> None:
    viewer = view(700, 560)
    page = viewer.page
    page.goto(f"{url}/embed#transparent=1&theme=dark")
    page.wait_for_selector(MOVING)
    viewer.wait_frames(3)
    assert page.evaluate("getComputedStyle(document.body).backgroundImage") == "none"
    page.goto(f"{url}/embed#surface=/v1/keys&modes=https://elsewhere.example/")
    page.wait_for_selector(MOVING)  # other addresses than those of trees are ignored
    assert [line for line in viewer.complaints if "elsewhere" in line] == []


def test_a_recorded_loop_closes_and_a_picture_has_all_pixels(view, browser, url, job_id) -> None:
    viewer = view(640, 480)
    page = viewer.page
    viewer.show(f"{url}/#job={job_id}")
    page.locator("#hide-panel").click()
    expect(page.locator("#panel")).to_be_hidden()
    page.locator("#hide-panel").click()
    with page.expect_download() as saved:
        page.locator("#save-picture").click()
    assert saved.value.suggested_filename == "sapling.png"
    picture = np.asarray(Image.open(io.BytesIO(saved.value.path().read_bytes())))
    assert picture.shape[2] == 4
    assert picture[..., 3].min() == 255, "the sky is missing"
    assert picture[..., :3].std() > 10
    page.locator("summary", has=page.locator("#h-light")).click()
    page.locator("#ground").uncheck()
    with page.expect_download() as saved:
        page.locator("#save-picture").click()
    assert np.asarray(Image.open(io.BytesIO(saved.value.path().read_bytes())))[0, 0, 3] == 0, (
        "no background is asked for"
    )
    page.locator("#ground").check()
    with page.expect_download(timeout=JOB_MS) as saved:
        page.locator("#save-video").click()
    assert saved.value.suggested_filename == "sapling.webm"
    content = saved.value.path().read_bytes()
    (PICTURES / "loop.webm").write_bytes(content)
    reader = browser.new_page()
    duration, width, height, pictures = reader.evaluate(
        FRAMES, [base64.b64encode(content).decode(), [0.0, 1 / 125, 0.5, 0.999]]
    )
    reader.close()
    expect(page.locator("#clock")).to_contain_text(f"{duration:.2f} s")
    assert (height, width) == picture.shape[:2]
    first, second, middle, last = np.asarray(pictures, float).reshape(4, -1)
    step, across, seam = (np.abs(first - other).mean() for other in (second, middle, last))
    assert across > 2 * step, "nothing moves"
    assert seam < 0.5 * (step + across), "the loop does not close"
