"""The page of the API in a real browser: it lists every operation, and one that is tried answers."""

import json

import httpx
from playwright.sync_api import expect


def test_the_api_page_lists_every_operation_and_runs_one(url, view, axe) -> None:
    page = view(1280, 900).page
    document = httpx.get(f"{url}/openapi.json").json()
    paths = [*document["paths"].values(), *document["webhooks"].values()]
    operations = [operation for path in paths for operation in path.values()]
    page.goto(f"{url}/docs")
    expect(page.locator(".opblock")).to_have_count(sum(len(operation.get("tags", [""])) for operation in operations))
    block = page.locator("[id$=listPresets]")
    block.locator(".opblock-summary-control").click()
    block.get_by_role("button", name="Try it out").click()
    block.get_by_role("button", name="Execute").click()
    answer = block.locator(".live-responses-table .response-col_description .microlight").first
    expect(answer).to_contain_text("small")
    assert json.loads(answer.inner_text())["data"] == httpx.get(f"{url}/v1/presets").json()["data"]
    page.locator("[id$=createJob] .opblock-summary-control").click()
    expect(page.locator("[id$=createJob] pre.microlight").first).to_be_visible()
    assert axe(page) == []
