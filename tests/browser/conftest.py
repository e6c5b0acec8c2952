"""A real service and a real browser: Debian's Chromium, drawing in software. `make browser` runs these."""

import io
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

from recipes.demo import serve
from recipes.software_browser import launch

MOVING = "body[data-state=moving]"
JOB_MS = 240_000.0
AXE = Path(__file__).parents[2] / ".cache/js-tools/node_modules/axe-core/axe.min.js"
PICTURES = Path(__file__).parents[2] / "build" / "browser"
PICTURES.mkdir(parents=True, exist_ok=True)
"""Where screenshots go."""


expect.set_options(timeout=120_000)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A browser takes minutes; the page's logic needs none."""
    for item in items:
        if item.path.parent == Path(__file__).parent and item.path.name != "test_page_logic.py":
            item.add_marker(pytest.mark.slow)
            if item.get_closest_marker("timeout") is None:
                item.add_marker(pytest.mark.timeout(900))


@pytest.fixture(scope="session")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("served")
    with serve(folder / "state", folder / "serve.log") as url:
        yield url


def job_of(
    url: str, *paths: Path, key: str | None = None, reading: dict[str, str] | None = None, **params: Any
) -> dict[str, Any]:
    """A job in few steps on files, read as said, which has ended."""
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with httpx.Client(base_url=url, timeout=60, headers=headers) as client:
        files = [("file", (path.name, path.read_bytes())) for path in paths]
        asset = client.post("/v1/assets", files=files, data=reading or {}).json()
        request = {"type": "animate", "asset_id": asset["id"], "params": {"formats": ["glb"], "num_steps": 1} | params}
        job: dict[str, Any] = client.post("/v1/jobs", json=request).json()
        while job["state"] in {"queued", "running"}:
            job = client.get(f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=30"}).json()
    assert job["state"] == "succeeded", job["error"]
    return job


def animated(url: str, mesh: Path, **options: Any) -> str:
    """The id of a job of a tree that moves, see `job_of`."""
    return str(job_of(url, mesh, **options)["id"])


@contextmanager
def web_server(folder: Path) -> Iterator[str]:
    """Serve a folder as any web server does; gives its address."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(folder))) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="session")
def job_id(url: str, tree: Path) -> str:
    """A job that has ended with a motion."""
    return animated(url, tree)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with sync_playwright() as driver:
        browser = launch(driver)
        yield browser
        browser.close()


@dataclass
class Viewer:
    """The page, and what its console says."""

    page: Page
    name: str
    complaints: list[str] = field(default_factory=list)
    expects: tuple[str, ...] = ()  # words that the console may say

    def open(self, url: str) -> None:
        """Go to the page, and wait until its script has run."""
        self.page.goto(url)
        self.page.wait_for_selector("body[data-ready]", state="attached")

    def show(self, url: str) -> None:
        """Go to the page of a job, and wait until its tree moves."""
        self.open(url)
        self.page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)

    def wait_sharp(self) -> None:
        """Until the picture on the screen has all its pixels and its shadow."""
        self.page.wait_for_selector("body[data-sharp=true]", state="attached")

    @property
    def frames(self) -> int:
        """Drawn so far."""
        return int(self.page.evaluate("document.body.dataset.frames ?? 0"))

    def wait_frames(self, count: int) -> None:
        """Until so many more are drawn."""
        goal, deadline = self.frames + count, time.monotonic() + 120
        while self.frames < goal:
            assert time.monotonic() < deadline, f"{count} frames took more than two minutes"
            self.page.wait_for_timeout(50)

    def wait_turns(self, count: int = 3) -> None:
        """Until the page has had its turn so often, however slow it is: what still moves is drawn anew in each."""
        self.page.evaluate(
            """(left) => new Promise((done) => {
                const turn = () => (left-- > 0 ? requestAnimationFrame(turn) : done());
                turn();
            })""",
            count,
        )


def press(page: Page, x: float, y: float, *, touch: bool) -> tuple[Callable[[float, float], None], Callable[[], None]]:
    """Press with the mouse or a finger; gives what moves it to a place, and what lifts it."""
    if not touch:
        page.mouse.move(x, y)
        page.mouse.down()
        return page.mouse.move, page.mouse.up
    session = page.context.new_cdp_session(page)

    def send(kind: str, *points: tuple[float, float]) -> None:
        dots = [{"x": px, "y": py} for px, py in points]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": dots})

    send("touchStart", (x, y))
    return (lambda px, py: send("touchMove", (px, py))), (lambda: send("touchEnd"))


Open = Callable[..., Viewer]
"""What the fixture `view` gives."""


def picture_of(viewer: Viewer, part: dict[str, float]) -> np.ndarray:
    """A part of the window, [H, W, 3]."""
    shot = viewer.page.screenshot(clip=part)  # type: ignore[arg-type]
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that differ clearly."""
    return float((np.abs(one - other).max(axis=2) > 24).mean())


def pixels(viewer: Viewer) -> np.ndarray:
    """The middle of the stage, [H, W, 3]."""
    box = viewer.page.locator("#canvas").bounding_box()
    panel = viewer.page.locator("#panel").bounding_box()
    assert box
    right = panel["x"] if panel and panel["y"] < box["height"] / 2 else box["width"]
    clip = {"x": 0, "y": 60, "width": right - 10, "height": box["height"] - 160}
    return picture_of(viewer, clip)


def scrub(viewer: Viewer, share: float) -> np.ndarray:
    """The picture at a place of the loop."""
    viewer.page.locator("#time").evaluate(
        "(slider, share) => { slider.value = share; slider.dispatchEvent(new Event('input')); }", share
    )
    viewer.wait_turns()
    viewer.wait_sharp()
    return pixels(viewer)


def steady(viewer: Viewer) -> np.ndarray:
    """The picture once nothing changes any more, the hint among it."""
    viewer.page.wait_for_selector("#hint.going", state="attached")
    before = pixels(viewer)
    for _ in range(90):
        viewer.page.wait_for_timeout(1000)
        viewer.wait_turns()
        viewer.wait_sharp()
        now = pixels(viewer)
        if changed(before, now) == 0:
            return now
        before = now
    raise AssertionError("the picture does not come to rest")


@pytest.fixture
def view(browser: Browser, request: pytest.FixtureRequest) -> Iterator[object]:
    """Open the page: width, height, scheme, touch; its console may not complain of anything unexpected."""
    opened: list[Viewer] = []

    def open_page(
        width: int, height: int, *, scheme: str = "light", touch: bool = False, locale: str = "en-US"
    ) -> Viewer:
        context = browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme=scheme,  # type: ignore[arg-type]
            has_touch=touch,
            is_mobile=touch,
            locale=locale,
        )
        context.set_default_timeout(120_000)
        viewer = Viewer(context.new_page(), request.node.name.removeprefix("test_"))
        viewer.page.on(
            "console", lambda line: line.type in {"error", "warning"} and viewer.complaints.append(line.text)
        )
        viewer.page.on("pageerror", lambda error: viewer.complaints.append(str(error)))
        opened.append(viewer)
        return viewer

    yield open_page
    for viewer in opened:
        viewer.page.context.close()
        assert [line for line in viewer.complaints if not any(part in line for part in viewer.expects)] == []


@pytest.fixture
def axe(request: pytest.FixtureRequest) -> Callable[[Page], list[str]]:
    """Violations of the accessibility rules, of what the page shows now."""
    if not AXE.is_file():
        pytest.skip("axe-core is not installed: make js-tools")

    def violations(page: Page) -> list[str]:
        page.evaluate(AXE.read_text())  # the page's policy allows no other script; the driver may evaluate
        report = page.evaluate("async () => (await axe.run()).violations")
        return [f"{item['id']}: {item['nodes'][0]['html'][:200]}" for item in report]

    return violations
