"""Time from opening the page to the first visible motion of the welcome's tree, in Chromium with software GL.

Each visit has an empty cache, in a browser window that has finished loading its own pages. `dynamictree serve` runs on
the same machine, so the network costs nothing; the bytes sent are reported. The time is that of the first frame in
which the tree's outline against the sky, read back from the canvas, differs from that of its first picture. A shadow
does not change the outline.

    python -m benchmarks first_motion
"""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks._machine import BRIEF, machine
from recipes.demo import serve

TARGET_S = 1.0
RUNS = 1 if BRIEF else 5
SIZE = {"width": 1280, "height": 800}
CHANGED = 110  # change of red [of 255]: the tree is dark before a light sky; a shadow changes the ground less
LEAST_PIXELS = 30
POLL_MS = 200
SETTLE_MS = 2500

WATCH = """({ changed, least }) => {
    const seen = { pictures: 0 };
    const note = (name) => { seen[name] ??= Math.round(performance.now()); };
    window.seen = seen;
    let first = null;
    const look = () => {
        const gl = document.getElementById("canvas").getContext("webgl2");
        const now = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
        gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, now); // waits
        seen.pictures++;
        if (first?.length !== now.length) {
            first = now;
            return note("tree");
        }
        let count = 0;
        for (let i = now.length / 2; i < now.length; i += 4) if (Math.abs(now[i] - first[i]) > changed) count++;
        if (count >= least) note("moved");
    };
    new MutationObserver((changes) => {
        const { body } = document;
        if (body?.dataset.ready) note("ready");
        if (body?.dataset.live) note("live");
        const drawn = changes.some(({ attributeName }) => attributeName === "data-frames");
        if (drawn && body.dataset.live && seen.moved === undefined) look();
    }).observe(document, { subtree: true, attributes: true });
}"""


def run() -> dict[str, object]:
    try:
        from playwright.sync_api import sync_playwright

        from recipes.software_browser import launch
    except ImportError:
        raise SystemExit("benchmarks: playwright is not installed") from None
    with (
        tempfile.TemporaryDirectory() as state,
        serve(Path(state), Path(state) / "serve.log") as url,
        sync_playwright() as driver,
    ):
        try:
            browser = launch(driver)
        except FileNotFoundError as error:
            raise SystemExit(f"benchmarks: {error}") from None
        whole = browser.new_browser_cdp_session()
        visits = []
        for _ in range(RUNS + 1):
            context = browser.new_context(viewport=SIZE)  # type: ignore[arg-type]
            page = context.new_page()
            page.add_init_script(f"({WATCH})({{ changed: {CHANGED}, least: {LEAST_PIXELS} }})")
            page.wait_for_timeout(SETTLE_MS)
            before = processor_s(whole)
            page.goto(url)
            while page.evaluate("window.seen.moved ?? null") is None:  # the page's CSP forbids `wait_for_function`
                page.wait_for_timeout(POLL_MS)
            used = {name: round(spent - before.get(name, 0), 2) for name, spent in processor_s(whole).items()}
            visits.append(page.evaluate(TIMES) | {"processor_s": used})
            context.close()
        browser.close()
    visits = sorted(visits[1:], key=lambda visit: float(visit["moved"]))  # the first visit is a warm-up
    middle = visits[RUNS // 2]
    return {
        "value": round(middle["moved"] / 1000, 2),
        "unit": "s",
        "target": TARGET_S,
        "max_s": round(visits[-1]["moved"] / 1000, 2),
        "visit": middle,
        "runs": RUNS,
        "window_px": f"{SIZE['width']} x {SIZE['height']}",
        **machine("playwright"),
    }


def processor_s(browser: Any) -> dict[str, float]:
    """Return the CPU time of the browser's processes by kind; that of all pages is summed."""
    spent: dict[str, float] = {}
    for process in browser.send("SystemInfo.getProcessInfo")["processInfo"]:
        spent[process["type"]] = spent.get(process["type"], 0.0) + process["cpuTime"]
    return spent


TIMES = """() => {
    const files = performance.getEntriesByType("resource");
    const end = (part) => {
        const ends = files.filter(({ name }) => part.test(name)).map(({ responseEnd }) => responseEnd);
        return Math.round(Math.max(0, ...ends));
    };
    const [page] = performance.getEntriesByType("navigation");
    return {
        ...window.seen,
        html: Math.round(page.responseEnd),
        modules: end(/\\.js$/),
        tree_files: end(/safetensors$/),
        painted: Math.round(performance.getEntriesByName("first-contentful-paint")[0]?.startTime ?? 0),
        requests: files.length + 1,
        kilobytes: Math.round([page, ...files].reduce((sum, { transferSize }) => sum + transferSize, 0) / 1000),
    };
}"""
