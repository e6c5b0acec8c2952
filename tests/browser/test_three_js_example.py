"""The three.js example of docs/web-developer.md draws a tree that moves, in Chromium."""

import re
import time
from pathlib import Path
from urllib.parse import urlsplit

from playwright.sync_api import Browser, Page, Route

from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from lab.dataset.sample import make_sample, voxel_spectrum

ROOT = Path(__file__).parents[2]
HTML = """<!doctype html><meta charset="utf-8"><body style="margin: 0">
<script type="importmap">{"imports": {"three": "/%s/three.module.js", "three/addons/": "/%s/addons/"}}</script>
<script type="module">%s</script>"""


def test_the_example_draws_a_tree_that_moves(browser: Browser, tmp_path: Path) -> None:
    blocks = re.findall(r"^```js\n(.*?)^```$", (ROOT / "docs/web-developer.md").read_text(), re.MULTILINE | re.DOTALL)
    [example] = [block for block in blocks if "GLTFLoader().loadAsync" in block]
    assert len(example.splitlines()) <= 22  # the page calls it twenty lines
    [three] = (path.relative_to(ROOT).as_posix() for path in (ROOT / "web/vendor").glob("three-*"))
    sample = make_sample(3, "sapling")
    glb = write_products(sample.mesh, voxel_spectrum(sample)[1], ExportParams(formats=("glb",)), tmp_path)["glb"]

    def answer(route: Route) -> None:
        path = urlsplit(route.request.url).path
        if path == "/":
            route.fulfill(body=HTML % (three, three, example), content_type="text/html")
        elif path == "/tree.glb":
            route.fulfill(path=glb)
        else:
            route.fulfill(path=ROOT / path.lstrip("/"), content_type="text/javascript")

    page = browser.new_page(viewport={"width": 320, "height": 240})
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.route("http://tree.test/**", answer)
    page.goto("http://tree.test/")
    page.wait_for_selector("canvas")
    tree = next_picture(page, page.screenshot())  # the tree appears
    next_picture(page, tree)  # and moves
    page.close()
    assert problems == []


def next_picture(page: Page, before: bytes) -> bytes:
    """The first picture that differs."""
    deadline = time.monotonic() + 90
    while (picture := page.screenshot()) == before:
        assert time.monotonic() < deadline, "nothing moves"
        page.wait_for_timeout(200)
    return picture
