"""The client against a real service with its worker: upload, wait, download, push, and the same on the command line."""

import asyncio
import hashlib
import json
from pathlib import Path

import pytest
from dynamictree_client import AsyncClient, Client, InvalidRequestError, NotFoundError, operations
from dynamictree_client.commands import app
from dynamictree_client.models import AnimateParams, At, Force, InteractRequest, Job, Wind
from safetensors.numpy import load
from typer.testing import CliRunner

PARAMS = AnimateParams(wind=Wind(speed_m_s=6.0), formats=["glb", "glb-morph"], num_steps=1)


@pytest.mark.slow
def test_a_tree_goes_in_and_comes_out_swaying_by_every_way_that_the_client_has(url, tree, tmp_path) -> None:
    seen = list[Job]()
    with Client(url) as client:
        asset = client.upload(tree)
        assert client.upload([tree], resumable=True).id == asset.id
        job = client.wait(client.animate(asset, PARAMS, seed=4), on_progress=seen.append)
        paths = client.download_all(job, tmp_path / "blocking")
        listed = {artifact.name: artifact.sha256 for artifact in client.artifacts(job)}
        assert {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in paths.items()} == listed
        assert {"tree.glb", "tree.spectrum.safetensors"} <= set(paths)
        facts = {artifact.name: artifact.facts for artifact in client.artifacts(job)}
        assert facts["tree-morph.glb"]["max_error_m"] >= facts["tree-morph.glb"]["rms_error_m"] > 0
        assert facts["tree.glb"]["num_joints"] > 100
        assert seen[-1].state == "succeeded"
        progress = [job.progress for job in seen]
        assert progress == sorted(progress)
        spectrum_id = job.result.spectrum_id if job.result else None
        assert spectrum_id is not None
        push = Force(kind="impulse", at=At(voxel=0), impulse_n_s=(0.0, 5.0, 0.0))
        answer = client.interact(InteractRequest(spectrum_id=spectrum_id, forces=[push], num_frames=3))
        assert len(answer.groups[0].q) == 3
        assert "shapes" in load(client.modes(spectrum_id))
        with pytest.raises(NotFoundError):
            client.wait("0" * 26)
        with pytest.raises(InvalidRequestError) as caught:
            client.animate(asset, PARAMS.model_copy(update={"fps": 1e9}))
        assert [error.pointer for error in caught.value.problem.errors] == ["/params/fps"]

    async def again() -> dict[str, Path]:
        async with AsyncClient(url) as client:
            job = await client.wait(await client.animate(tree, PARAMS, seed=4), timeout_s=60)
            assert all(stage.cached for stage in job.stages)
            return await client.download_all(job, tmp_path / "asynchronous", names=["tree.glb"])

    assert asyncio.run(again())["tree.glb"].read_bytes() == paths["tree.glb"].read_bytes()

    run = CliRunner()
    at = ["--url", url]
    arguments = ["animate", str(tree), "-o", str(tmp_path / "remote"), "--format", "glb", "--num-steps", "1", "--json"]
    result = run.invoke(app, [*arguments, "--seed", "4", "--wind-speed", "6", *at])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "remote" / "tree.glb").read_bytes() == paths["tree.glb"].read_bytes()
    remote_id = json.loads(result.stdout)["job"]
    assert remote_id in run.invoke(app, ["jobs", *at]).stdout
    assert json.loads(run.invoke(app, ["jobs", "--json", *at]).stdout)[0]["id"] == remote_id
    assert json.loads(run.invoke(app, ["show", remote_id, *at]).stdout)["state"] == "succeeded"
    assert json.loads(run.invoke(app, ["wait", remote_id, *at]).stdout)["state"] == "succeeded"
    got = run.invoke(app, ["get", remote_id, "-o", str(tmp_path / "got"), "--name", "tree.glb", "--json", *at])
    assert json.loads(got.stdout)["files"] == [str(tmp_path / "got" / "tree.glb")]
    assert run.invoke(app, ["cancel", remote_id, *at]).exit_code == 2
    refused = run.invoke(app, [*arguments[:-1], "--format", "doc", *at])
    assert refused.exit_code == 2
    assert "formats" in refused.stderr
    with Client(url) as client:
        client.send(operations.delete_asset(asset.id))
