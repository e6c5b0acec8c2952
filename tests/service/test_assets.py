import io
import json
import zipfile
from functools import cache
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from PIL import Image

from dynamictree.formats.tensors.bundle import read_mesh_bundle
from jobs.storage.assets import read_asset
from jobs.store import new_id
from service.http.multipart import MAX_FILES, MAX_PARTS
from service.services import Services
from tests.formats import meshes
from tests.formats.meshes import image_bytes, triangle_gltf, written
from tests.service.conftest import change_services, refusal
from tests.service.tus import whole

OBJ = b"""mtllib tree.mtl
v 0.45 0.5 0
v 0.55 0.5 0
v 0 0 2
v 1 1 2
usemtl bark
f 1 2 3
f 2 3 4
"""
PLAIN = OBJ.replace(b"mtllib tree.mtl\n", b"").replace(b"usemtl bark\n", b"")
MTL = b"newmtl bark\nKd 0.5 0.25 0.1\n"


def send(client: TestClient, *files: tuple[str, bytes], **fields: str) -> object:
    return client.post("/v1/assets", files=[("file", (name, content)) for name, content in files], data=fields)


def raw(client: TestClient, body: bytes) -> object:
    return client.post("/v1/assets", content=body, headers={"Content-Type": "multipart/form-data; boundary=B"})


def zipped(*entries: tuple[str, bytes]) -> bytes:
    return meshes.zipped(dict(entries))


@cache
def photo(number: int, size: tuple[int, int] = (400, 300)) -> bytes:
    return written(Image.new("RGB", size, (25 * number % 256, 100, 50)).save, format="JPEG")


@pytest.mark.parametrize("way", ["form", "uploads", "auto"])
def test_texts_of_the_client_come_back(client: TestClient, way: str) -> None:
    texts = {"plot": "17", "Baum": "Bäume"}
    if way == "form":
        sent = client.post("/v1/assets", files={"file": ("tree.obj", OBJ)}, data={"metadata": json.dumps(texts)})
    elif way == "uploads":
        body = {"upload_ids": [whole(client, OBJ, filename="tree.obj")], "metadata": texts}
        sent = client.post("/v1/assets", json=body)
    else:
        upload_id = whole(client, OBJ, filename="tree.obj", asset="auto", metadata=json.dumps(texts))
        ready = client.get(f"/v1/uploads/{upload_id}", headers={"Prefer": "wait=30"}).json()
        sent = client.get(f"/v1/assets/{ready['asset_id']}")
    assert sent.json()["metadata"] == texts, sent.text
    again = client.post("/v1/assets", files={"file": ("tree.obj", OBJ)})
    assert (again.json()["id"], again.json()["metadata"]) == (sent.json()["id"], texts)
    for wrong in ("[1]", "no JSON", json.dumps({"a": 1}), json.dumps(dict.fromkeys(map(str, range(17)), "x"))):
        refused = client.post("/v1/assets", files={"file": ("tree.obj", OBJ)}, data={"metadata": wrong})
        assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "form:metadata")


def left_behind(services: Services) -> list[Path]:
    return list(services.settings.scratch_dir.rglob("*"))


def test_a_mesh_becomes_an_asset(client: TestClient, services: Services) -> None:
    response = send(client, ("tree.obj", OBJ), ("tree.mtl", MTL), up_axis="+Z", unit_m="2")
    assert response.status_code == 201, response.text
    asset = response.json()
    assert response.headers["Location"] == f"/v1/assets/{asset['id']}"
    assert (asset["summary"]["num_vertices"], asset["summary"]["num_faces"]) == (4, 2)
    assert asset["summary"]["extent_m"] == [2.0, 2.0, 4.0]
    assert [part["name"] for part in asset["parts"]] == ["tree.obj", "tree.mtl"]
    assert client.get(response.headers["Location"]).json() == asset
    prepared = read_asset(services.store, asset["id"]).prepared
    assert prepared is not None
    mesh = read_mesh_bundle(io.BytesIO(b"".join(services.artifacts.read(prepared.sha256))))
    assert mesh.look.materials[0].name == "bark"
    assert left_behind(services) == []


@pytest.mark.parametrize("way", ["zip", "form"])
def test_as_many_photos_as_are_allowed_come_with_masks_and_cameras(client: TestClient, way: str) -> None:
    pictures = [(f"{n:03}.jpg", photo(n % 200, (400, 300 + n // 200))) for n in range(300)]
    masks = [(f"masks/{name}", photo(255)) for name, _ in pictures]
    files = [*pictures, *masks, *((f"{name}.txt", b"#") for name in ("cameras", "images", "points3D"))]
    response = send(client, ("walk.zip", zipped(*files))) if way == "zip" else send(client, *files)
    assert response.status_code == 201, response.text
    assert len(response.json()["parts"]) == 603
    uploads = {"upload_ids": [new_id() for _ in files]}
    assert client.post("/v1/assets", json=uploads).status_code == 404  # as many, but none that is there


def test_the_same_files_are_the_same_asset(client: TestClient) -> None:
    first = send(client, ("tree.obj", OBJ), ("tree.mtl", MTL))
    again = send(client, ("tree.obj", OBJ), ("tree.mtl", MTL))
    other = send(client, ("tree.obj", OBJ), ("tree.mtl", MTL), unit_m="2")
    packed = send(client, ("all.zip", zipped(("tree.obj", OBJ), ("tree.mtl", MTL))))
    assert (first.status_code, again.status_code, other.status_code, packed.status_code) == (201, 200, 201, 200)
    assert first.json()["id"] == again.json()["id"] == packed.json()["id"]
    assert other.json()["id"] != first.json()["id"]


def test_what_operating_systems_add_is_left_out(client: TestClient) -> None:
    hidden = (("__MACOSX/._tree.obj", b"\0\5\26\7"), (".DS_Store", b"\0"), ("Thumbs.db", b"\xd0\xcf"))
    plain = send(client, ("tree.obj", OBJ), ("tree.mtl", MTL)).json()
    packed = send(client, ("all.zip", zipped(("tree.obj", OBJ), *hidden, ("tree.mtl", MTL))))
    assert packed.status_code == 200, packed.text  # the same asset
    assert packed.json()["id"] == plain["id"]
    parts = send(client, ("tree.obj", OBJ), *((name.rpartition("/")[2], content) for name, content in hidden))
    assert parts.status_code == 201, parts.text
    photos = [(f"p{i}.jpg", photo(i)) for i in range(8)]
    with_thumbnails = send(client, ("photos.zip", zipped(*photos, *hidden, ("__MACOSX/._p0.jpg", b"\0"))))
    assert with_thumbnails.status_code == 201, with_thumbnails.text
    assert with_thumbnails.json()["summary"]["num_photos"] == 8


def test_a_zip_of_windows_is_read_with_its_folders_and_code_page(client: TestClient) -> None:
    obj = OBJ.replace(b"tree.mtl", "素材\\木.mtl".encode("cp932"))
    raw = "素材\\木.mtl".encode("cp932").decode("cp437")
    stored = zipped(("tree\\tree.obj", obj), ("~" * len(raw), MTL)).replace(b"~" * len(raw), raw.encode("cp437"))
    response = send(client, ("木.zip", stored), up_axis="+Z")
    assert response.status_code == 201, response.text
    assert "not sent along" not in response.text


@pytest.mark.parametrize(
    "disposition",
    [
        "form-data; name=file; filename=\"=?utf-8?B?QsOkdW1lLm9iag==?=\"; filename*=utf-8''B%C3%A4ume.obj",  # .NET
        'form-data; name=file; filename="=?utf-8?B?QsOkdW1lLm9iag==?="',
        "form-data; name=file; filename*=UTF-8''B%C3%A4ume.obj",
        "form-data; name=file; filename=\"Ba.obj\"; filename*=utf-8'de'B%C3%A4ume.obj",
    ],
)
def test_a_file_name_may_be_encoded(client: TestClient, disposition: str) -> None:
    body = b"--B\r\nContent-Disposition: " + disposition.encode() + b"\r\n\r\n" + OBJ + b"\r\n--B--\r\n"
    response = raw(client, body)
    assert response.status_code == 201, response.text
    assert [part["name"] for part in response.json()["parts"]] == ["Bäume.obj"]


def test_live_photos_are_taken_without_their_films(client: TestClient) -> None:
    heic = [written(Image.new("RGB", (320, 240), (25 * n, 100, 50)).save, format="HEIF") for n in range(3)]
    photos = [(f"IMG_{number}.HEIC", content) for number, content in enumerate(heic)]
    photos += [(f"IMG_{number}.JPG", photo(number)) for number in range(3, 8)]
    response = send(client, *photos, *((f"IMG_{number}.MOV", b"film") for number in range(3)))
    assert response.status_code == 201, response.text
    assert (response.json()["kind"], response.json()["summary"]["num_photos"]) == ("photos", 8)
    [warning] = response.json()["summary"]["warnings"]
    assert warning["message"].startswith("3 films of Live Photos were not used, IMG_0.MOV first")
    assert "by itself" in send(client, *photos, ("walk.mov", b"film")).json()["detail"]


def test_a_photo_is_checked(client: TestClient) -> None:
    good = [(f"p{i}.jpg", photo(i)) for i in range(7)]
    assert send(client, *good).json()["code"] == "invalid-input"
    copies = send(client, *((f"{number}.jpg", photo(1)) for number in range(40)))
    assert "there are 40 photos and 1 of them differ" in copies.json()["detail"]
    assert send(client, *good, ("p7.jpg", b"no photo")).json()["code"] == "unsupported-format"
    assert "damaged" in send(client, *good, ("p7.jpg", photo(7)[:400])).json()["detail"]
    assert "pixels" in send(client, *good, ("p7.jpg", photo(7, (20, 20)))).json()["detail"]
    assert send(client, *good, ("p7.txt", photo(7)), kind="photos").json()["code"] == "unsupported-format"


BAD_ZIPS = {
    "outside": [("../tree.obj", OBJ)],
    "absolute": [("/tree.obj", OBJ)],
    "drive": [("C:/tree.obj", OBJ)],
    "dot": [("tree.obj", OBJ), (".", b"x")],
    "nested": [("tree.obj", OBJ), ("more.zip", zipped(("a", b"b")))],
    "bomb": [("tree.obj", OBJ), ("zeros", bytes(50_000_000))],
    "many": [(f"f{i}", b"x") for i in range(MAX_FILES + 1)],
    "none": [],
}


@pytest.mark.parametrize("what", BAD_ZIPS)
def test_a_bad_zip_is_rejected(client: TestClient, services: Services, what: str) -> None:
    refusal(send(client, ("all.zip", zipped(*BAD_ZIPS[what]))), 422, "archive-rejected")
    assert left_behind(services) == []


def test_a_zip_with_a_link_a_twin_damage_or_a_false_size_is_rejected(client: TestClient) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        link = zipfile.ZipInfo("tree.obj")
        link.external_attr = 0o120777 << 16
        archive.writestr(link, "/etc/passwd")
    assert "symbolic link" in send(client, ("all.zip", packed.getvalue())).json()["detail"]
    twin = zipped(("tree.obj", OBJ), ("tref.obj", OBJ)).replace(b"tref", b"tree")
    assert "twice" in send(client, ("all.zip", twin)).json()["detail"]
    nameless = zipped(("tree.obj", OBJ), ("~~~", b"x")).replace(b"~~~", b"\0ab")  # zipfile reads a name to its NUL
    refusal(send(client, ("all.zip", nameless)), 422, "archive-rejected")
    whole = bytearray(zipped(("tree.obj", OBJ * 100)))
    whole[60:80] = bytes(20)
    assert send(client, ("all.zip", bytes(whole))).json()["code"] == "archive-rejected"
    honest, size = zipped(("tree.obj", OBJ * 50)), len(OBJ * 50).to_bytes(4, "little")
    assert honest.count(size) == 2
    small = honest.replace(size, (10).to_bytes(4, "little"))
    assert send(client, ("all.zip", small)).json()["code"] == "archive-rejected"


@pytest.mark.parametrize(
    ("fields", "pointer"),
    [
        ({"kind": "video"}, "form:kind"),
        ({"up_axis": "up"}, "form:up_axis"),
        ({"unit_m": "foot"}, "form:unit_m"),
        ({"unit_m": "nan"}, "form:unit_m"),
        ({"colour": "red"}, "form:colour"),
    ],
)
def test_a_wrong_option_is_named(client: TestClient, fields: dict[str, str], pointer: str) -> None:
    response = send(client, ("tree.obj", OBJ), **fields)
    assert (response.status_code, "pattern" in response.text) == (422, False)
    assert [error["pointer"] for error in response.json()["errors"]] == [pointer]


def test_which_file_is_the_mesh_must_be_clear(client: TestClient) -> None:
    assert "2 meshes" in send(client, ("a.obj", OBJ), ("b.ply", OBJ)).json()["detail"]
    assert send(client, ("a.mtl", MTL), ("b.txt", b"x")).json()["code"] == "unsupported-format"
    refused = send(client, ("a.cr2", b"x"), ("b.cr2", b"y")).json()
    assert refused["code"] == "unsupported-format"
    assert all(f" {suffix}" in refused["detail"] for suffix in ("jpg", "heic", "mov", "glb"))
    assert client.post("/v1/assets", files={"kind": (None, "mesh")}).json()["code"] == "validation-failed"


KIND = b'--B\r\nContent-Disposition: form-data; name="kind"\r\n\r\n%s\r\n'


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b'--B\r\nContent-Disposition: form-data; name="file"; filename="a.obj"\r\n\r\nv 0', "bad-request"),
        (b"no boundary", "bad-request"),
        (b"--B\r\nContent-Disposition: form-data\r\n\r\nx\r\n--B--\r\n", "bad-request"),
        (KIND % b"\xff" + b"--B--\r\n", "bad-request"),
        (KIND % b"a\0b" + b"--B--\r\n", "bad-request"),
        (KIND % (b"x" * 5000) + b"--B--\r\n", "payload-too-large"),
        (KIND % b"mesh" * (MAX_PARTS + 1) + b"--B--\r\n", "payload-too-large"),
    ],
)
def test_a_broken_form_is_refused(client: TestClient, services: Services, body: bytes, code: str) -> None:
    response = raw(client, body)
    assert response.json()["code"] == code, response.text
    assert left_behind(services) == []


def test_a_parser_that_takes_too_much_is_ended(client: TestClient, services: Services) -> None:
    small = services.settings.model_copy(update={"parser_memory_bytes": 64 * 1024**2})
    change_services(client, settings=small)
    refusal(send(client, ("tree.obj", OBJ)), 422, "input-too-costly")
    assert left_behind(services) == []


def multi_file_gltf() -> dict[str, bytes]:
    root, binary = triangle_gltf(
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        textures=[{"source": 0}],
        images=[{"uri": "textures/bark.png"}],
        buffers=[{"byteLength": 42, "uri": "scene.bin"}],
    )
    root["meshes"][0]["primitives"][0]["material"] = 0  # type: ignore[index]
    content = json.dumps(root).encode()
    return {"scene.gltf": content, "scene.bin": binary, "textures/bark.png": image_bytes(), "license.txt": b"CC-BY"}


@pytest.mark.parametrize("way", ["zip", "zip of a folder", "parts", "parts without paths"])
def test_a_gltf_of_several_files_is_taken(client: TestClient, way: str) -> None:
    files = list(multi_file_gltf().items())
    if way.startswith("zip"):
        top = "" if way == "zip" else "maple tree/"
        files = [("tree.zip", zipped(*((top + name, content) for name, content in files)))]
    elif way == "parts without paths":
        files = [(name.rpartition("/")[2], content) for name, content in files]
    response = send(client, *files, unit_m="1")  # else a cube of one unit is doubted
    assert response.status_code == 201, response.text
    assert response.json()["summary"]["warnings"] == []


def test_a_3mf_is_a_mesh_and_no_archive(client: TestClient) -> None:
    import trimesh

    content = trimesh.creation.cylinder(radius=100, height=5000).export(file_type="3mf")
    response = send(client, ("tree.3mf", content))
    assert response.status_code == 201, response.text
    assert response.json()["summary"]["height_m"] == pytest.approx(5.0)
