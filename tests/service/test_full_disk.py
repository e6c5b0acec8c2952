"""A small disk: space is reserved before bytes arrive, and the service goes on by itself."""

import io
import shutil
import zipfile
from pathlib import Path

import numpy as np
from fastapi.testclient import TestClient

from jobs.settings import Settings
from service.app import create_app

MIB = 1024**2
TREE = b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"


def test_a_zip_is_refused_before_it_is_unpacked_onto_a_full_disk(small_disk: Path, settings: Settings) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tree.obj", TREE)
        archive.writestr("notes.txt", np.random.default_rng(0).integers(0, 2, MIB, np.uint8).tobytes() * 40)
    own = {"state_dir": small_disk, "min_free_bytes": 24 * MIB}
    with TestClient(create_app(settings.model_copy(update=own)), "http://localhost") as client:
        sent = client.post("/v1/assets", files={"file": ("tree.zip", packed.getvalue())})
        assert (sent.status_code, sent.json()["code"]) == (503, "disk-full"), sent.text
        assert shutil.disk_usage(small_disk).free > 48 * MIB
