"""The page's states in a real browser: breaks, links, several trees, words, and what a screen reader is given."""

import json
import re
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.mesh import join_meshes
from tests.browser.conftest import Open, Viewer, animated
from tests.formats.meshes import written
from tests.plant import stand

JOB_MS = 300_000.0
LIT = """() => { const gl = document.getElementById("canvas").getContext("webgl2");
    window.loss = gl.getExtension("WEBGL_lose_context"); window.loss.loseContext(); }"""


def state(page: Page, name: str) -> None:
    """Wait for a state of the page."""
    page.wait_for_selector(f"body[data-state={name}]", state="attached", timeout=JOB_MS)


@pytest.fixture
def moving(view: Open, url: str, job_id: str) -> Viewer:
    """The tree of a job that has ended, in motion."""
    viewer = view(900, 620)
    viewer.open(f"{url}/#job={job_id}")
    state(viewer.page, "moving")
    return viewer


def test_two_trees_dropped_both_begin(view: Open, url: str, tree: Path, tmp_path: Path) -> None:
    second = tmp_path / "second.glb"
    second.write_bytes(tree.read_bytes())
    viewer = view(900, 620)
    viewer.open(url)
    with httpx.Client(base_url=url, timeout=60) as client:
        before = len(client.get("/v1/jobs", params={"limit": 100}).json()["data"])
        viewer.page.set_input_files("#files", [str(tree), str(second)])
        expect(viewer.page.locator("#notice")).to_contain_text("2 trees begin")
        deadline = 60
        while len(client.get("/v1/jobs", params={"limit": 100}).json()["data"]) < before + 2:
            viewer.page.wait_for_timeout(1000)
            deadline -= 1
            assert deadline, "the second tree has no job"
    state(viewer.page, "moving")


def test_a_break_of_the_connection_keeps_the_card(view: Open, url: str, tree: Path) -> None:
    viewer = view(900, 620)
    page, viewer.expects = viewer.page, ("ERR_INTERNET_DISCONNECTED",)
    viewer.open(url)
    page.set_input_files("#files", str(tree))
    expect(page.locator("#stages li")).not_to_have_count(0)
    page.context.set_offline(True)
    if page.evaluate("document.body.dataset.state") != "moving":
        expect(page.locator("#away")).to_be_visible(timeout=3000)
        expect(page.locator("#progress-eta")).to_have_text("")
    page.context.set_offline(False)
    state(page, "moving")
    expect(page.locator("#away")).to_be_hidden()


def begun(url: str, tree: Path, **request: object) -> str:
    """A job's id."""
    asset = httpx.post(f"{url}/v1/assets", files={"file": (tree.name, tree.read_bytes())}, timeout=60).json()
    return str(httpx.post(f"{url}/v1/jobs", json={"asset_id": asset["id"]} | request, timeout=60).json()["id"])


def test_a_canceled_job_can_be_tried_again(view: Open, url: str, tree: Path) -> None:
    job_id = begun(url, tree, type="animate", seed=77)
    httpx.post(f"{url}/v1/jobs/{job_id}/cancel", timeout=60)
    viewer = view(900, 620)
    viewer.open(f"{url}/#job={job_id}")
    alert = viewer.page.get_by_role("alert")
    expect(alert).to_contain_text("This job was canceled")
    alert.get_by_role("button", name="Try again").click()
    state(viewer.page, "moving")
    assert job_id not in viewer.page.url


def test_voxels_only_are_said_to_be_that(view: Open, url: str, tree: Path) -> None:
    viewer = view(900, 620)
    viewer.open(f"{url}/#job={begun(url, tree, type='voxelize')}")
    alert = viewer.page.get_by_role("alert")
    expect(alert).to_contain_text("made no motion", timeout=JOB_MS)
    alert.get_by_role("button", name="Give it motion").click()
    state(viewer.page, "moving")


@pytest.fixture
def new_job(url: str, tree: Path) -> str:
    """A job at the top of the list, whatever else ran before."""
    return animated(url, tree)


def test_links_and_back_lead_where_they_say(view: Open, url: str, new_job: str) -> None:
    viewer = view(900, 620)
    page = viewer.page
    viewer.open(url)
    page.locator("#open-jobs").click()
    page.locator(f"#job-list [data-key='{new_job}'] .open").click()
    state(page, "moving")
    assert page.url.endswith(f"#job={new_job}")
    expect(page).to_have_title(re.compile("sapling"))
    page.go_back()
    state(page, "welcome")
    page.goto(f"{url}/#job={new_job}")
    state(page, "moving")
    link = page.locator("#artifacts a", has_text="Animated GLB")
    expect(link).to_have_attribute("download", "sapling.glb")


def test_the_job_list_stays_while_it_is_refreshed(view: Open, url: str, new_job: str) -> None:
    viewer = view(900, 620)
    page = viewer.page
    viewer.open(url)
    page.locator("#open-jobs").click()
    item = page.locator(f"#job-list [data-key='{new_job}']")
    expect(item.locator("img")).to_have_attribute("src", re.compile("^blob:"))
    item.evaluate("(node) => { node.mark = true; }")
    item.locator(".open").focus()
    page.wait_for_timeout(5000)  # two refreshes
    assert item.evaluate("(node) => node.mark && node.contains(document.activeElement)")
    page.locator("#job-filter").select_option("failed")
    expect(page.locator("#no-jobs")).to_be_visible()


def test_a_job_is_deleted_by_the_second_press(view: Open, url: str, tree: Path) -> None:
    job_url = f"{url}/v1/jobs/{(job_id := begun(url, tree, type='voxelize'))}"
    httpx.get(job_url, headers={"Prefer": "wait=30"}, timeout=60)
    viewer = view(390, 760, touch=True)
    page = viewer.page
    viewer.open(f"{url}/#job={job_id}")
    expect(page.get_by_role("alert")).to_contain_text("made no motion", timeout=JOB_MS)
    page.locator("#open-jobs").click()
    item = page.locator(f"#job-list [data-key='{job_id}']")
    item.locator(".delete").click()
    expect(item.locator(".delete")).to_have_text("Delete it and its files?")
    assert httpx.get(job_url, timeout=60).status_code == 200, "one press is not enough"
    item.locator(".delete").click()
    expect(item).to_have_count(0)
    assert httpx.get(job_url, timeout=60).status_code == 410
    page.keyboard.press("Escape")
    expect(page.get_by_role("alert")).to_contain_text("You have deleted this tree")
    expect(page.locator("#problem-retry")).to_be_hidden()
    viewer.expects = ("410",)


def test_the_graphics_context_is_lost_and_comes_back(moving: Viewer) -> None:
    viewer, page = moving, moving.page
    viewer.wait_frames(2)
    page.evaluate(LIT)
    expect(page.locator("#context-lost")).to_be_visible()
    page.evaluate("window.loss.restoreContext()")
    expect(page.locator("#context-lost")).to_be_hidden()
    viewer.wait_frames(4)
    picture = page.screenshot()
    page.locator("#play").click()
    assert len(picture) > 20_000, "nothing is drawn"


def test_another_language_and_feet(view: Open, url: str, job_id: str) -> None:
    viewer = view(900, 620, locale="de-DE")
    page = viewer.page
    viewer.open(url)
    expect(page.get_by_role("heading", level=2).first).to_have_text("Ein Baum hinein, und er bewegt sich.")
    assert page.evaluate("document.documentElement.lang") == "de"
    page.locator("#open-settings").click()
    page.locator("#unit").select_option("ft")
    page.wait_for_selector("body[data-ready]", state="attached")
    viewer.open(f"{url}/#job={job_id}")
    page.reload()
    state(page, "moving")
    expect(page.locator("#caption")).to_contain_text(re.compile(r"\d,\d ft"))


def test_sliders_say_their_values(moving: Viewer) -> None:
    page = moving.page
    expect(page.locator("#artifacts a")).not_to_have_count(0, timeout=JOB_MS)
    names = page.evaluate("[...document.querySelectorAll('input[type=range]')].map((i) => [i.id, i.ariaValueText])")
    silent = [name for name, words in json.loads(json.dumps(names)) if not words and not name.startswith("crop")]
    assert silent == []
    assert page.evaluate("document.querySelectorAll('output').length") == 0, "live regions per frame"
    page.locator("#wind-presets button", has_text="Gale").click()
    expect(page.locator("#speed")).to_have_attribute("aria-valuetext", "14.0 m/s")
    expect(page.locator("#wind-presets [aria-pressed=true]")).to_have_text("Gale")
    box = page.locator("#dial").bounding_box()
    assert box
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 4)
    expect(page.locator("#direction")).to_have_attribute("aria-valuetext", "90° N")


def test_one_of_several_trees_is_chosen(view: Open, url: str, tmp_path: Path) -> None:
    one = stand.tree(6.0, num_cards=60)
    pair = join_meshes([one, one.with_vertices(one.vertices + np.float32([5, 0, 0]))])
    (tmp_path / "pair.ply").write_bytes(written(write_ply, pair))
    viewer = view(1000, 700)
    page = viewer.page
    viewer.open(url)
    waiting: list[Route] = []
    page.route("**/v1/jobs", lambda route: waiting.append(route) or None)
    page.set_input_files("#files", str(tmp_path / "pair.ply"))
    page.locator("#tree-details summary").click()
    expect(page.locator("#which-tree option")).to_have_text(["All 2", "Tree 1, 5.9 m", "Tree 2, 5.9 m"])
    page.locator("#which-tree").select_option("2")
    while not waiting:
        page.wait_for_timeout(100)
    waiting[0].continue_()  # its job comes once the choice is made
    page.unroute("**/v1/jobs")
    page.wait_for_url("**/#job=*")
    expect(page.locator("#which-tree")).to_have_value("2")
    with page.expect_request(lambda request: request.method == "POST" and request.url.endswith("/v1/jobs")) as sent:
        page.locator("#apply-tree").click()
    assert sent.value.post_data_json["params"]["tree"] == 2
    expect(page.locator("#which-tree")).to_have_value("2")
    page.locator("#cancel").click()
    state(page, "welcome")
