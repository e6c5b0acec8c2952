"""The MCP server as a program of its own, called by the reference client of the protocol, over a real service."""

import asyncio
import os
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from mcp import Client, StdioServerParameters

TOOLS = {"upload", "animate", "wait_for_job", "download", "interact", "cancel", "list_recent_jobs", "download_link"}


async def _call(client: Client, name: str, **arguments: Any) -> Any:
    answer = await client.call_tool(name, arguments)
    assert not answer.is_error, answer.content
    return answer.structured_content


async def _refused(client: Client, name: str, **arguments: Any) -> str:
    answer = await client.call_tool(name, arguments)
    assert answer.is_error
    return str(answer.content)


def _program(url: str, folder: Path) -> StdioServerParameters:
    command = ["-m", "dynamictree_client.mcp_server", "--url", url, "--folder", str(folder)]
    path = str(Path(__file__).parents[2] / "client")
    return StdioServerParameters(command=sys.executable, args=command, env=dict(os.environ) | {"PYTHONPATH": path})


def test_the_tools_are_listed_and_files_elsewhere_are_refused(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "secret.glb").write_bytes(b"secret")

    async def talk() -> None:
        async with Client(_program("http://127.0.0.1:9", tmp_path / "own")) as client:
            tools = (await client.list_tools()).tools
            assert {tool.name for tool in tools} == TOOLS
            assert all(tool.description for tool in tools)
            for name in ("../secret.glb", str(tmp_path / "secret.glb")):
                assert "outside of" in await _refused(client, "upload", paths=[name])
                assert "outside of" in await _refused(client, "download", job_id="0" * 26, folder=name)
            assert "less than or equal" in await _refused(client, "wait_for_job", job_id="0" * 26, timeout_s=1e9)

    asyncio.run(talk())


@pytest.mark.slow
def test_a_model_uploads_animates_waits_downloads_and_pushes(url: str, tree: Path, tmp_path: Path) -> None:
    (tmp_path / "tree.glb").write_bytes(tree.read_bytes())

    async def talk() -> None:
        async with Client(_program(url, tmp_path)) as client:
            asset = await _call(client, "upload", paths=["tree.glb"])
            job = await _call(client, "animate", asset_id=asset["asset_id"], formats=["glb"], seed=2)
            assert job["state"] in {"queued", "running"}
            for _ in range(100):
                job = await _call(client, "wait_for_job", job_id=job["job_id"], timeout_s=5)
                if job["state"] not in {"queued", "running"}:
                    break
            assert (job["state"], job["error"]) == ("succeeded", None)
            paths = await _call(client, "download", job_id=job["job_id"], folder="out", names=["tree.glb"])
            assert paths == {"result": ["out/tree.glb"]}
            assert (tmp_path / "out" / "tree.glb").read_bytes()[:4] == b"glTF"
            listed = await _call(client, "list_recent_jobs", limit=1)
            assert [one["job_id"] for one in listed["result"]] == [job["job_id"]]
            link = await _call(client, "download_link", job_id=job["job_id"], file="tree.glb")
            assert httpx.get(link["result"]).content[:4] == b"glTF"
            assert "has succeeded" in await _refused(client, "cancel", job_id=job["job_id"])
            soft, hard = [
                await _call(client, "interact", spectrum_id=job["spectrum_id"], vector=[newtons, 0, 0], seconds=1)
                for newtons in (1.0, 2.0)
            ]
            assert max(soft["largest_amplitude"]) > 0
            ratios = [
                h / s for s, h in zip(soft["largest_amplitude"], hard["largest_amplitude"], strict=True) if s > 1e-9
            ]
            assert ratios == pytest.approx([2.0] * len(ratios), rel=1e-3)  # the response is linear in the force
            assert "no job" in await _refused(client, "wait_for_job", job_id="01ARZ3NDEKTSV4RRFFQ69G5FAV")

    asyncio.run(talk())
