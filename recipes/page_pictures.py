"""Take the pictures of docs/viewer.md and of the page's examples, with the page in Chromium and a running service.

    python -m recipes.page_pictures

Needs playwright and a Chromium (Debian's, or of `BROWSER_PATH`). WebGL is drawn in software, so any machine can do it;
the pictures are taken of paused trees with all pixels and shadows.
"""

import io
import tempfile
from pathlib import Path

import httpx
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from recipes.demo import response_body, serve
from recipes.software_browser import launch

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "web" / "examples"
EXAMPLE = "round-broadleaf"
PICTURES = ROOT / "docs" / "pictures"
DESKTOP, PHONE, SQUARE = (1280, 800), (390, 760), (1000, 760)
THUMBNAIL_PX, THUMBNAIL_QUALITY, MARGIN = 192, 76, 0.04
PHASE = 0.48
"""Phase in the loop at which both trees of the first picture are far from rest."""
LONGEST_MS = 300_000
WEBP_QUALITY = 84


def main() -> None:
    with (
        tempfile.TemporaryDirectory(prefix="dynamictree-") as folder,
        serve(Path(folder) / "state", Path(folder) / "serve.log") as url,
        sync_playwright() as driver,
    ):
        browser = launch(driver)
        for path in sorted(EXAMPLES.glob("*.glb")):
            _take_example(_opened(browser, f"{url}/#job={_animated(url, path, num_steps=1)}", SQUARE), path.stem)
        _take(_opened(browser, url, DESKTOP), "viewer-welcome", state="[data-live=true]")
        job_id = _animated(url, EXAMPLES / f"{EXAMPLE}.glb")
        page = _opened(browser, f"{url}/#job={job_id}", DESKTOP)
        page.wait_for_selector("body[data-state=moving]", state="attached", timeout=LONGEST_MS)
        page.locator("#company input[value=pair]").check(force=True)
        _take(page, "viewer", state="[data-state=moving]", phase=PHASE)
        _take(_opened(browser, f"{url}/#job={job_id}", PHONE), "viewer-phone", state="[data-state=moving]", phase=PHASE)
        browser.close()


def _animated(url: str, mesh: Path, **params: int) -> str:
    """Run a job on a mesh until it has ended; return its id."""
    with httpx.Client(base_url=url, timeout=120) as client:
        asset = response_body(client.post("/v1/assets", files={"file": (mesh.name, mesh.read_bytes())}))
        request = {"type": "animate", "asset_id": asset["id"], "seed": 7, "params": {"formats": ["glb"], **params}}
        job = response_body(client.post("/v1/jobs", json=request))
        while job["state"] in ("queued", "running"):
            job = response_body(client.get(f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=30"}))
    if job["state"] != "succeeded":
        raise SystemExit(f"the job {job['state']}: {job['error']}")
    return str(job["id"])


def _opened(browser: Browser, address: str, size: tuple[int, int]) -> Page:
    touch = size[0] < 600
    viewport = {"width": size[0], "height": size[1]}
    context = browser.new_context(viewport=viewport, has_touch=touch, is_mobile=touch)  # type: ignore[arg-type]
    context.set_default_timeout(LONGEST_MS)
    page = context.new_page()
    page.goto(address)
    return page


def _take(page: Page, name: str, *, state: str, phase: float | None = None) -> None:
    """Write a picture of the page at rest: paused, at full resolution, without hints."""
    page.wait_for_selector(f"body{state}", state="attached")
    if phase is None:
        page.locator("#canvas").focus()
        page.keyboard.press("Space")
        page.evaluate("document.activeElement.blur()")
    else:
        page.locator("#time").evaluate(
            "(slider, share) => { slider.value = share; slider.dispatchEvent(new Event('input')); }", phase
        )
        page.wait_for_selector("#hint.going", state="attached")
    page.wait_for_timeout(3000)  # wait until the other tree's wind has started and the hint has faded
    page.wait_for_selector("body[data-sharp=true]", state="attached")
    path = PICTURES / f"{name}.webp"
    with Image.open(io.BytesIO(page.screenshot())) as picture:
        picture.convert("RGB").save(path, quality=WEBP_QUALITY, method=6)
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
    page.context.close()


def _take_example(page: Page, name: str) -> None:
    """Write the picture of an example, without ground and background, for light and dark buttons."""
    page.wait_for_selector("body[data-state=moving]", state="attached")
    page.locator("#speed").fill("0")  # no arrow on the ground
    page.locator("#light-section summary").click()
    page.locator("#ground").uncheck()
    page.locator("#background").select_option("none")
    page.wait_for_timeout(3000)  # wait until the wind has stopped
    with page.expect_download() as download:
        page.locator("#save-picture").click()
    path = EXAMPLES / f"{name}.webp"
    with Image.open(download.value.path()) as picture:
        tree = picture.crop(picture.getchannel("A").getbbox())
    side = round((1 + 2 * MARGIN) * max(tree.size))
    square = Image.new("RGBA", (side, side))
    square.paste(tree, ((side - tree.width) // 2, side - tree.height - round(MARGIN * side)))
    square.resize((THUMBNAIL_PX, THUMBNAIL_PX), Image.Resampling.LANCZOS).save(
        path, quality=THUMBNAIL_QUALITY, method=6
    )
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
    page.context.close()


if __name__ == "__main__":
    main()
