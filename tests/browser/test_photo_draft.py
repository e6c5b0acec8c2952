"""Who waits for a tree of photos sees it come to be."""

import httpx
import pytest
from playwright.sync_api import expect

from tests.browser.conftest import JOB_MS, changed, pixels
from tests.reconstruct.conftest import photographed

pytestmark = pytest.mark.timeout(1800)

PARAMS = {"formats": ["splat"], "num_steps": 1, "splat_steps": 600, "height_m": 1.2}
LONGEST_MS = 6 * JOB_MS
MESH_IS_SEEN = """async () => {
    const { tree } = (await (await import("/web/page/early.js")).page).scene;
    const apart = tree.points && tree.points.box.max.distanceTo(tree.surface.box.max) / tree.surface.box.max.length();
    const mesh = [tree.mesh.material].flat().some(({ colorWrite }) => colorWrite);
    return { mesh, splat: Boolean(tree.splat?.drawn), apart };
}"""
LEAST_DRAWN = 0.02  # share of the stage's pixels


@pytest.fixture
def running_job(url: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    orbit = photographed(tmp_path_factory.mktemp("photos"))
    with httpx.Client(base_url=url, timeout=60) as client:
        files = [("file", (path.name, path.read_bytes())) for path in orbit.photos]
        asset = client.post("/v1/assets", files=files).json()
        job = client.post("/v1/jobs", json={"type": "animate", "asset_id": asset["id"], "params": PARAMS}).json()
    return str(job["id"])


def artifacts(url: str, job_id: str) -> set[str]:
    listed = httpx.get(f"{url}/v1/jobs/{job_id}/artifacts", timeout=60).json()["artifacts"]
    return {artifact["name"] for artifact in listed}


def test_the_splat_is_shown_while_it_is_learned_and_then_the_tree(view, url, running_job) -> None:
    viewer = view(1100, 720)
    page = viewer.page
    viewer.open(f"{url}/#job={running_job}")
    empty = pixels(viewer)
    while "draft.splat" not in artifacts(url, running_job):
        assert httpx.get(f"{url}/v1/jobs/{running_job}", timeout=60).json()["state"] in {"queued", "running"}
        page.wait_for_timeout(500)
    assert page.locator("body").get_attribute("data-state") == "running"
    while changed(pixels(viewer), empty) < LEAST_DRAWN:
        assert page.locator("body").get_attribute("data-state") == "running", "nothing was shown"
        page.wait_for_timeout(500)
    expect(page.locator("body")).to_have_attribute("data-state", "moving", timeout=LONGEST_MS)
    assert "draft.splat" not in artifacts(url, running_job)
    seen = page.evaluate(MESH_IS_SEEN)
    assert not seen["mesh"]
    assert seen["apart"] < 0.3, "the splat at rest does not stand as the mesh does"
    assert changed(pixels(viewer), empty) > LEAST_DRAWN
    while not (seen := page.evaluate(MESH_IS_SEEN))["splat"]:
        assert not seen["mesh"]
        page.wait_for_timeout(200)
    assert not seen["mesh"]
