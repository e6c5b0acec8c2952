"""Examples of requests in the OpenAPI document; tests validate them against its schemas."""

from typing import Any

_ASSET, _FILE, _SPECTRUM = (f"01M0TREE{what:0>18}" for what in ("ASSET", "F11E", "SPECTR0M"))
_SHA = "9f2c1e" + "0" * 58

_ANIMATE = {
    "type": "animate",
    "asset_id": _ASSET,
    "seed": 7,
    "params": {"wind": {"speed_m_s": 6.0, "direction_deg": 90.0, "gust": 0.3}, "formats": ["glb", "png"]},
}
_PUSH = {
    "spectrum_id": _SPECTRUM,
    "forces": [{"kind": "impulse", "at": {"voxel": 4711}, "impulse_n_s": [0.0, 5.0, 0.0], "duration_s": 0.1}],
    "num_frames": 120,
}
_PULL_AND_RELEASE = {
    "spectrum_id": _SPECTRUM,
    "forces": [
        {"kind": "drag", "at": {"point_m": [0.4, 0.0, 7.9]}, "displacement_m": [0.0, 0.3, 0.0], "duration_s": 0.5}
    ],
    "start": "held",
    "num_frames": 240,
}

_HOOK = {"url": "https://example.com/hook", "events": ["job.first-artifact", "job.succeeded", "job.failed"]}
_ENDPOINT = {"all": {"summary": "Told of every job", "value": _HOOK}}

REQUESTS: dict[str, dict[str, Any]] = {
    "createJob": {
        "animate": {"summary": "A tree that sways, as GLB and a picture", "value": _ANIMATE},
        "diffuse": {"summary": "The spectrum alone", "value": {"type": "diffuse", "asset_id": _ASSET, "seed": 7}},
        "voxelize": {"summary": "The voxels alone", "value": {"type": "voxelize", "asset_id": _ASSET}},
        "reconstruct": {"summary": "A mesh of photos", "value": {"type": "reconstruct", "asset_id": _ASSET}},
    },
    "createAsset": {
        "uploads": {"summary": "Of uploads that are whole", "value": {"upload_ids": [_FILE]}},
        "address": {"summary": "From an address", "value": {"url": "https://example.com/tree.glb", "sha256": _SHA}},
    },
    "interact": {
        "knock": {"summary": "A knock against a branch", "value": _PUSH},
        "pull": {"summary": "Pull a branch aside, hold it, let go", "value": _PULL_AND_RELEASE},
    },
    "createLink": {"hour": {"summary": "For an hour", "value": {"path": f"/v1/artifacts/{_FILE}", "expires_s": 3600}}},
    "createWebhookEndpoint": _ENDPOINT,
}
"""Example bodies by operation id."""
