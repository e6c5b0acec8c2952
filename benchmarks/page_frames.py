"""Frame rate of the page while a tree moves, in Chromium with software GL: three trees, with and without shadows.

Each example is uploaded to `dynamictree serve` on the same machine and animated; its job's page is opened at
1280 × 800, and drawn frames are counted. The value is the slowest example's without shadows.

    python -m benchmarks page_frames
"""

import tempfile
import time
from pathlib import Path
from statistics import median

import httpx

from benchmarks._machine import machine
from recipes.demo import serve

TARGET = 30.0
EXAMPLES = ("round-broadleaf", "weeping", "conical-conifer")
SIZE = {"width": 1280, "height": 800}
RUNS, SECONDS = 5, 3
SETTLE_MS = 5000
MOVING_MS = 120_000
FRAMES = "Number(document.body.dataset.frames)"


def run() -> dict[str, object]:
    try:
        from playwright.sync_api import Page, sync_playwright

        from recipes.software_browser import launch
    except ImportError:
        raise SystemExit("benchmarks: playwright is not installed") from None

    def rate(page: Page) -> float:
        rates = []
        for _ in range(RUNS):
            before, began = page.evaluate(FRAMES), time.perf_counter()
            page.wait_for_timeout(1000 * SECONDS)
            rates.append((page.evaluate(FRAMES) - before) / (time.perf_counter() - began))
        return round(median(rates), 1)

    rates: dict[str, dict[str, float]] = {}
    with (
        tempfile.TemporaryDirectory() as state,
        serve(Path(state), Path(state) / "serve.log") as url,
        sync_playwright() as driver,
    ):
        jobs = {name: _moved(url, Path("web/examples") / f"{name}.glb") for name in EXAMPLES}
        try:
            browser = launch(driver)
        except FileNotFoundError as error:
            raise SystemExit(f"benchmarks: {error}") from None
        for name, job in jobs.items():
            page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
            page.goto(f"{url}/#job={job}")
            page.wait_for_selector("body[data-state=moving]", state="attached", timeout=MOVING_MS)
            page.wait_for_timeout(SETTLE_MS)
            shaded = rate(page)
            page.locator("#light-section summary").click()
            page.locator("#shadows").uncheck()
            page.locator("#light-section summary").click()
            page.wait_for_timeout(SETTLE_MS)
            rates[name] = {"with_shadows": shaded, "without": rate(page)}
            page.close()
        browser.close()
    return {
        "value": min(of["without"] for of in rates.values()),
        "unit": "frames/s",
        "target": TARGET,
        "by_tree": rates,
        "runs": RUNS,
        "window_px": f"{SIZE['width']} x {SIZE['height']}",
        **machine("playwright"),
    }


def _moved(url: str, mesh: Path) -> str:
    with httpx.Client(base_url=url, timeout=120) as client:
        asset = client.post("/v1/assets", files={"file": (mesh.name, mesh.read_bytes())}).json()
        request = {"type": "animate", "asset_id": asset["id"], "params": {"formats": ["glb"]}}
        job = client.post("/v1/jobs", json=request).json()
        while job["state"] in {"queued", "running"}:
            job = client.get(f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=30"}).json()
    assert job["state"] == "succeeded", job["error"]
    return str(job["id"])
