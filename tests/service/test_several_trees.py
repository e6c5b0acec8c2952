"""Assets of several trees tell where each stands; a job takes one of them by number."""

import io

import numpy as np
from fastapi.testclient import TestClient

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.mesh import joined
from tests.plant.stand import tree
from tests.service.test_clouds import send


def test_an_asset_lists_its_trees_and_a_job_takes_one(client: TestClient) -> None:
    one, stream = tree(6.0, num_cards=60), io.BytesIO()
    write_ply(joined([one, one.with_vertices(one.vertices + np.float32([5, 0, 0]))]), stream)
    asset = send(client, ("two.ply", stream.getvalue())).json()
    assert [entry["tree"] for entry in asset["summary"]["trees"]] == [1, 2]
    assert [entry["code"] for entry in asset["summary"]["warnings"]] == ["several-trees"]
    assert client.get(f"/v1/assets/{asset['id']}").json()["summary"]["trees"] == asset["summary"]["trees"]
    body = {"type": "voxelize", "asset_id": asset["id"], "params": {"tree": 2}}
    assert client.post("/v1/jobs", json=body).json()["params"]["tree"] == 2
    refused = client.post("/v1/jobs", json=body | {"params": {"tree": 3}})
    assert refused.status_code == 422
    assert [error["pointer"] for error in refused.json()["errors"]] == ["/params/tree"]
