"""Film half a minute of the page for the README: the welcome, a pull, a drop, the moving tree, a storm, a forest.

    python -m recipes.page_film

Needs playwright and a Chromium, as `recipes.page_pictures`. The page's time is stepped frame by frame, so the film is
smooth however slowly the machine draws; only the job runs in its own time, of which two pictures a second are shown.
"""

import argparse
import io
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from recipes.demo import serve
from recipes.software_browser import launch

ROOT = Path(__file__).parents[1]
TREE = ROOT / "web" / "examples" / "weeping.glb"
OUTPUT = ROOT / "docs" / "pictures" / "page.webp"
WINDOW, FILM = (1120, 700), (640, 400)
FPS = 8
MOST_BYTES = 3_000_000
"""Largest size of a picture in the README [bytes]."""
LONGEST_MS = 600_000

# A page clock that is stepped manually once `film` is called, and an arrow at the pointer
CLOCK = """(() => {
    const [real, own] = [requestAnimationFrame.bind(window), performance.now.bind(performance)];
    let now = null, waiting = [];
    window.requestAnimationFrame = (next) => (now === null ? real(next) : waiting.push(next));
    performance.now = () => now ?? own();
    window.film = () => { now ??= own(); };
    window.step = (ms) => { now += ms; for (const next of waiting.splice(0)) next(now); };
})();
addEventListener("DOMContentLoaded", () => {
    const arrow = document.body.appendChild(document.createElement("div"));
    const shape = "<path d='M2 2v22l6-5 4 9 4-2-4-9h8z' fill='white' stroke='black' stroke-width='2'/>";
    const picture = `<svg xmlns='http://www.w3.org/2000/svg' width='30' height='34'>${shape}</svg>`;
    Object.assign(arrow.style, { position: "fixed", zIndex: 9999, pointerEvents: "none", width: "30px", height: "34px",
        background: `url("data:image/svg+xml,${encodeURIComponent(picture)}")` });
    addEventListener("pointermove", ({ clientX: x, clientY: y }) => {
        Object.assign(arrow.style, { left: `${x}px`, top: `${y}px` });
    }, true);
});"""

BRANCH = """async () => {
    const { hand, stage } = await (await import("/web/page/early.js")).page;
    const { pickVoxel } = await import("/web/draw/pick.js");
    const places = [];
    for (let y = 80; y < 420; y += 12) for (let x = 560; x < 1110; x += 12) {
        if (pickVoxel(hand.tree, { clientX: x, clientY: y }) !== null) places.push([x, y]);
    }
    return places.sort((a, b) => b[0] - a[0])[Math.floor(places.length / 12)];
}"""


class Film:
    """Pictures of a page, one per 1 / FPS of the page's own time."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.frames: list[Image.Image] = []

    def shoot(self) -> None:
        """Take one picture of the page."""
        with Image.open(io.BytesIO(self.page.screenshot())) as picture:
            self.frames.append(picture.convert("RGB").resize(FILM, Image.Resampling.LANCZOS))

    def run(self, seconds: float, each: Callable[[float], None] = lambda share: None) -> None:
        """Advance the page's time; call `each(share)` with the elapsed share before each frame."""
        count = round(seconds * FPS)
        for n in range(count):
            each((n + 1) / count)
            self.page.evaluate("(ms) => { step(ms / 2); step(ms / 2); }", 1000 / FPS)
            self.shoot()

    def move(self, start: tuple[float, float], end: tuple[float, float], seconds: float) -> None:
        """Move the pointer while time advances."""

        def each(share: float) -> None:
            smooth = share * share * (3 - 2 * share)
            self.page.mouse.move(*(a + smooth * (b - a) for a, b in zip(start, end, strict=True)))

        self.run(seconds, each)


@contextmanager
def open_page(url: str) -> Iterator[Page]:
    """Context manager that opens the page in a browser, with the film's clock."""
    with sync_playwright() as driver:
        browser = launch(driver)
        context = browser.new_context(viewport={"width": WINDOW[0], "height": WINDOW[1]}, locale="en-US")
        context.set_default_timeout(LONGEST_MS)
        page = context.new_page()
        page.add_init_script(CLOCK)
        page.goto(url)
        page.wait_for_selector("body[data-live=true]", state="attached")
        page.wait_for_selector("body[data-ready]", state="attached")
        yield page
        browser.close()


def take_pictures(page: Page) -> list[Image.Image]:
    """Take the pictures of the half-minute film."""
    film = Film(page)
    page.evaluate("film()")
    page.mouse.move(900, 600)
    film.run(2)
    x, y = page.evaluate(BRANCH)
    film.move((900, 600), (x, y), 1)
    page.mouse.down()
    film.move((x, y), (x - 90, y + 70), 1.25)
    page.mouse.up()
    film.run(2.5)
    _drop(film)
    film.run(6.5)
    _press(film, "#wind-presets li:last-child button")
    film.run(5)
    _press(film, "#wind-presets li:nth-child(3) button")
    _press(film, "#company label:last-child")
    film.run(5)
    return film.frames


def _drop(film: Film) -> None:
    """Upload a tree to the page; take two pictures per second of its job, shown at eight per second."""
    page = film.page
    page.locator("#veil").evaluate("(veil) => { veil.hidden = false; }")
    film.run(0.75)
    page.locator("#veil").evaluate("(veil) => { veil.hidden = true; }")
    page.set_input_files("#files", str(TREE))
    while page.evaluate("document.body.dataset.state") != "moving":
        page.evaluate("step(50)")
        film.shoot()
        page.wait_for_timeout(500)


def _press(film: Film, selector: str) -> None:
    box = film.page.locator(selector).bounding_box()
    assert box
    film.move((700, 500), (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2), 0.75)
    film.page.locator(selector).click(force=True)


def write_film(frames: list[Image.Image], path: Path) -> None:
    """Write a looping WebP with the best quality that `MOST_BYTES` allows."""
    for quality in range(70, 10, -10):
        content = io.BytesIO()
        first, *others = frames
        options = {"save_all": True, "append_images": others, "duration": round(1000 / FPS), "loop": 0, "method": 4}
        first.save(content, "WEBP", quality=quality, **options)  # type: ignore[arg-type]
        if content.tell() <= MOST_BYTES:
            break
    path.write_bytes(content.getvalue())
    print(f"{path}  {content.tell() / 1e6:.2f} MB, {len(frames) / FPS:.0f} s, quality {quality}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    arguments = parser.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="dynamictree-") as folder,
        serve(Path(folder) / "state", Path(folder) / "serve.log") as url,
        open_page(url) as page,
    ):
        frames = take_pictures(page)
    write_film(frames, arguments.output)


if __name__ == "__main__":
    main()
