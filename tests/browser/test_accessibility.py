"""Rules of accessibility on what the page shows, by axe-core: three sizes, light and dark."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import JOB_MS, MOVING, Viewer

SIZES = ((1100, 720, "light"), (390, 760, "dark"), (780, 360, "light"))


@pytest.fixture(params=SIZES, ids=lambda size: f"{size[0]}x{size[1]}-{size[2]}")
def viewer(view: Callable[..., Viewer], request: pytest.FixtureRequest) -> Viewer:
    width, height, scheme = request.param
    return view(width, height, scheme=scheme, touch=width < 800)


def test_no_rule_of_accessibility_is_broken(viewer, url, job_id, axe) -> None:
    page = viewer.page
    viewer.open(url)
    assert axe(page) == [], "welcome"
    page.locator("#open-jobs").click()
    expect(page.locator("#job-list li").first).to_be_visible()
    assert axe(page) == [], "jobs"
    page.keyboard.press("Escape")
    page.goto(f"{url}/#job={job_id}")
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    viewer.wait_frames(2)
    page.locator("#light-section summary").click()
    page.locator("#tree-details summary").click()
    page.locator("#more summary").click()
    expect(page.locator("#more-formats li").first).to_be_attached()
    assert axe(page) == [], "moving"
    assert page.viewport_size
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    page.locator("#download").click()
    assert axe(page) == [], "kits"
    page.locator("#kits .close").click()
    page.locator("#share").click()
    expect(page.locator("#share-embed")).to_have_value(re.compile(job_id))
    assert axe(page) == [], "share"
    page.goto(f"{url}/embed#job={job_id}")
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    assert axe(page) == [], "embed"


def test_company_and_the_question_before_a_delete_break_no_rule(viewer, url, job_id, axe) -> None:
    page = viewer.page
    viewer.show(f"{url}/#job={job_id}")
    page.locator("#company input[value=forest]").check(force=True)
    viewer.wait_frames(2)
    assert axe(page) == [], "forest"
    page.locator("#company input[value=pair]").check(force=True)
    expect(page.locator("#plates span").first).to_be_visible()
    assert axe(page) == [], "compared with another speed"
    page.locator("#open-jobs").click()
    remove = page.locator(f"#job-list [data-key='{job_id}'] .delete")
    remove.click()
    expect(remove).to_have_text("Delete it and its files?")
    assert axe(page) == [], "the question before a delete"
