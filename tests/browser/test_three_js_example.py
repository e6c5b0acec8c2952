"""The three.js example of docs/web-developer.md draws a tree that moves, in Chromium."""

import re
from pathlib import Path

from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.browser.conftest import Open, web_server

ROOT = Path(__file__).parents[2]
HTML = """<!doctype html><meta charset="utf-8"><body style="margin: 0">
<script type="importmap">{"imports": {"three": "/%s/three.module.js", "three/addons/": "/%s/addons/"}}</script>
<script type="module">%s</script>"""


def test_the_example_draws_a_tree_that_moves(view: Open, tmp_path: Path) -> None:
    blocks = re.findall(r"^```js\n(.*?)^```$", (ROOT / "docs/web-developer.md").read_text(), re.MULTILINE | re.DOTALL)
    [example] = [block for block in blocks if "GLTFLoader().loadAsync" in block]
    assert len(example.splitlines()) <= 22  # the page calls it twenty lines
    [three] = (path.relative_to(ROOT).as_posix() for path in (ROOT / "web/vendor").glob("three-*"))
    sample = make_sample(3, "sapling")
    write_products(sample.mesh, voxel_spectrum(sample)[1], ExportParams(formats=("glb",)), tmp_path)
    (tmp_path / "web").symlink_to(ROOT / "web")
    (tmp_path / "index.html").write_text(HTML % (three, three, example))
    viewer = view(320, 240)
    page, viewer.expects = viewer.page, ("404",)  # an icon of the page
    with web_server(tmp_path) as origin:
        page.goto(origin)
        page.wait_for_selector("canvas")
        pictures: set[bytes] = set()
        while len(pictures) < 3:  # the empty canvas, the tree, and the tree elsewhere; else the test runs out of time
            pictures.add(page.screenshot())
