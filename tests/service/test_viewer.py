"""What the viewer is given: its own files, and trees to draw."""

# ruff: noqa: F811

import base64
import gzip
import hashlib
import re
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from threading import Semaphore

import numpy as np
import pytest
from fastapi.testclient import TestClient
from pydantic import ValidationError
from safetensors.numpy import load

import web
from dynamictree.formats.motion import html
from dynamictree.rig.rig import rig_of
from jobs.records import AssetRecord
from jobs.settings import Settings
from jobs.store import new_id
from service.app import create_app
from service.interact import stored_trees
from service.local.serve import print_when_ready
from service.routes import pages, surface
from tests.line import answering
from tests.service.conftest import refusal
from tests.service.pushed import ASSET_ID, client, grown, served_id, spectrum, spectrum_id  # noqa: F401
from web.vendor import FOLDER, LIBRARIES, SUMS

WEB = Path(web.__file__).parent
LARGE = {"shapes", "scale_m", "lean_m", "bone_parent", "bone_foot_m", "bone_reach_m", "bone_turns", "bone_scale_rad"}
OTHER_HOST = re.compile(r"""["'(=]\s*(?:https?:|wss?:)?//(?!www\.w3\.org|localhost)[a-z]""")


def test_the_page_names_the_hash_of_its_one_inline_script(client: TestClient) -> None:
    response = client.get("/")
    assert response.headers["Content-Type"] == "text/html; charset=utf-8"
    policy = dict(part.split(" ", 1) for part in response.headers["Content-Security-Policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert "unsafe-inline" not in str(policy)
    assert not re.search(r"<[^>]*\s(?:style|on\w+)\s*=", response.text)
    [import_map] = re.findall(r"<script(?![^>]*\ssrc=)[^>]*>(.*?)</script>", response.text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(import_map.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in policy["script-src"].split()


STATIC_IMPORT = re.compile(r'''^(?:import|export)\s(?:[^"';]*?\sfrom\s)?"([^"]+)"''', re.MULTILINE)


def imported(path: Path, modules: set[Path]) -> set[Path]:
    """A module and all that it imports before it runs, of ours, added to `modules`."""
    if path not in modules:
        modules.add(path)
        for name in STATIC_IMPORT.findall(path.read_text()):
            if name.startswith("."):
                imported((path.parent / name).resolve(), modules)
    return modules


def test_every_module_that_the_page_begins_with_is_loaded_at_once() -> None:
    """Without the list they are found level by level, which delays the first picture."""
    page = (WEB / "index.html").read_text()
    listed = re.findall(r'<link rel="modulepreload" href="./web/([^"]+)"', page)
    ours = {path for path in listed if not path.startswith("vendor/")}
    modules = imported(WEB / "page/begin.js", imported(WEB / "page/early.js", set()))
    assert ours == {str(path.relative_to(WEB)) for path in modules}
    assert len(listed) == len(ours) + 3 == len(set(listed))


def test_a_page_from_disk_imports_what_the_viewer_exports() -> None:
    player, modules = "player_splat.js", html._CORE | html._SPLAT
    for names, module in re.findall(r'^import \{ (.*) \} from "(.*)"', html._beside(player), re.MULTILINE):
        source = (WEB / modules[module]).read_text()
        exported = set(re.findall(r"^export (?:async )?(?:const|class|function) (\w+)", source, re.MULTILINE))
        assert set(names.split(", ")) <= exported, module


ANY_IMPORT = re.compile(r'''(?:from|import)\s*\(?\s*"(\.[^"]+)"''')


def test_no_module_of_the_page_imports_itself() -> None:
    """Neither at once nor later: a part that others need is given to them."""
    modules = [path.resolve() for path in WEB.rglob("*.js") if FOLDER not in path.parents]
    needs = {
        path: {(path.parent / name).resolve() for name in ANY_IMPORT.findall(path.read_text())} for path in modules
    }
    try:
        assert len(tuple(TopologicalSorter(needs).static_order())) >= len(modules)
    except CycleError as cycle:
        raise AssertionError(" → ".join(path.name for path in cycle.args[1])) from None


def test_addresses_that_do_not_exist_take_no_memory(client: TestClient) -> None:
    client.get("/web/app.js")
    before = set(pages.packed_pages)
    assert {client.get(f"/web/none-{number}.js").status_code for number in range(20)} == {404}
    assert set(pages.packed_pages) == before


def test_nothing_of_ours_names_another_host() -> None:
    kinds = {".js", ".css", ".html", ".svg"}
    ours = [path for path in WEB.rglob("*") if path.suffix in kinds and FOLDER not in path.parents]
    assert len(ours) > 40
    assert [path.name for path in ours if OTHER_HOST.search(path.read_text())] == []


def test_vendored_files_are_those_of_the_list() -> None:
    listed = dict(line.split("  ")[::-1] for line in (FOLDER / SUMS).read_text().splitlines())
    present = {
        str(path.relative_to(FOLDER)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in FOLDER.rglob("*")
        if path.is_file() and path.name != SUMS
    }
    assert present == listed
    assert set(listed) == {path for library in LIBRARIES for path in library.targets}
    assert all(any("LICENSE" in path for path in library.targets) for library in LIBRARIES)


def test_files_are_packed_and_not_sent_twice(client: TestClient) -> None:
    path = "/web/page/session.js"
    packed = client.get(path)
    assert packed.headers["Content-Encoding"] == "gzip"
    assert packed.content == (WEB / "page/session.js").read_bytes()
    plain = client.get(path, headers={"Accept-Encoding": "identity"})
    assert "Content-Encoding" not in plain.headers
    assert len(gzip.compress(plain.content)) < len(plain.content) / 2
    again = client.get(path, headers={"If-None-Match": packed.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert client.head(path).status_code == 200


def test_the_api_page_loads_its_own_files_only(client: TestClient) -> None:
    page = client.get("/docs")
    policy = dict(part.split(" ", 1) for part in page.headers["Content-Security-Policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == "'self'"
    files = re.findall(r'(?:src|href)="\./([^"]+)"', page.text)
    assert {client.get(f"/{path}").status_code for path in files} == {200}
    assert "<script>" not in page.text


def test_vendored_libraries_are_cached_for_ever_under_their_version(client: TestClient) -> None:
    [import_map] = re.findall(r'"three": "\./(web/vendor/[^"]+)"', client.get("/").text)
    assert re.search(r"-\d+\.\d+\.\d+/", import_map)
    assert "immutable" in client.get(f"/{import_map}").headers["Cache-Control"]
    assert client.get("/web/app.js").headers["Cache-Control"] == "no-cache"


def test_no_module_of_the_page_is_longer_than_a_reader_takes() -> None:
    modules = {*WEB.rglob("*.js")} - {*FOLDER.rglob("*.js"), *WEB.glob("texts/*")}  # tables need no reader
    assert [path.name for path in modules if len(path.read_text().splitlines()) > 250] == []


def test_every_language_has_every_text() -> None:
    keys = {}
    for name in ("en", "de"):
        keys[name] = set(re.findall(r'^  "([^"]+)":', (WEB / f"texts/{name}.js").read_text(), re.MULTILINE))
    assert keys["en"] == keys["de"]
    used = set(re.findall(r'data-(?:text|label)="([^"]+)"', (WEB / "index.html").read_text()))
    for path in WEB.rglob("page/*.js"):
        used |= set(re.findall(r'\btext\("([^"]+)"', path.read_text()))
    assert used - keys["en"] == set()


@pytest.mark.parametrize(
    "path",
    ["nothing.js", "vendor.py", "__init__.py", "../service/app.py", "%2e%2e/pyproject.toml", "vendor", "package.json"],
)
def test_nothing_else_is_given_away(client: TestClient, path: str) -> None:
    response = client.get(f"/web/{path}")
    assert response.status_code == 404
    assert response.json()["code"] == "not-found"


def test_an_asset_is_shown_as_it_was_read(client: TestClient, spectrum_id: str, grown) -> None:
    tensors = load(client.get(f"/v1/assets/{ASSET_ID}/surface").content)
    np.testing.assert_array_equal(tensors["vertices"], grown.mesh.vertices)
    np.testing.assert_array_equal(tensors["faces"], grown.mesh.faces)
    assert not {"shapes", "turn_shapes"} & set(tensors)


def test_a_surface_names_the_vertices_that_stand_still(grown) -> None:
    faces = grown.mesh.faces
    tensors = surface.mesh_tensors(replace(grown.mesh, still_faces=np.arange(len(faces)) < 5))
    alone = np.setdiff1d(faces[:5], faces[5:])
    np.testing.assert_array_equal(np.flatnonzero(tensors["still"]), alone)
    assert "still" not in surface.mesh_tensors(grown.mesh)


def test_an_asset_that_is_no_mesh_or_has_lost_its_bytes_has_no_surface(client: TestClient, asset: AssetRecord) -> None:
    refusal(client.get(f"/v1/assets/{asset.id}/surface"), 410, "expired")


def test_the_rig_of_a_job_that_runs_is_awaited(client: TestClient, services, spectrum_id: str, monkeypatch) -> None:
    looks, job, kind = [], services.store.job, type(services.store)
    monkeypatch.setattr(services.trees, "get", lambda _: None)
    monkeypatch.setattr(stored_trees, "find_stored", lambda *_: looks.append(1))
    monkeypatch.setattr(kind, "job", lambda _, id: replace(job(id), state="succeeded" if looks[2:] else "running"))
    monkeypatch.setattr(stored_trees, "_AWAITING", Semaphore(0))  # as many wait as may
    refused = client.get(f"/v1/spectra/{spectrum_id}/modes")
    assert (refused.status_code, refused.json()["code"], refused.headers["Retry-After"]) == (503, "overloaded", "5")
    monkeypatch.setattr(stored_trees, "_AWAITING", place := Semaphore(1))
    assert client.get(f"/v1/spectra/{spectrum_id}/modes").status_code == 200
    assert len(looks) == 1 + 3
    assert place.acquire(blocking=False), "it keeps its place"


def test_a_surface_has_the_bones_that_turn_in_the_wind(client, spectrum_id, grown, spectrum, tmp_path) -> None:
    tensors = load(client.get(f"/v1/spectra/{spectrum_id}/surface").content)
    rig = rig_of(grown.mesh, spectrum)
    skeleton, turns = rig.skeleton, rig.turns.copy()
    turns[:, 1:] *= 2
    step_rad = tensors["turn_step_rad"]
    parts = (np.tensordot([1, 256], tensors["turn_shapes"], 1) - surface.ZERO) * step_rad[:, None, None, None]
    apart = np.abs(parts - np.stack([turns.real, turns.imag], axis=-1)).max(axis=(1, 2, 3))
    assert (apart <= 0.501 * step_rad).all()
    assert (step_rad * np.linalg.norm(skeleton.reach_m, axis=1)).max() < 1e-5 * grown.mesh.height_m
    rows, shares = rig.vertices.rows[:, 0], rig.vertices.shares[:, 1]
    for name, expected in (("parent", skeleton.parent), ("bone", rows), ("share", shares)):
        np.testing.assert_allclose(tensors[f"turn_{name}"], expected, atol=1e-6)
    np.testing.assert_allclose(tensors["turn_foot_m"], skeleton.foot_m, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(tensors["turn_direction"], axis=1), 1, atol=1e-6)
    modes = load(client.get(f"/v1/spectra/{spectrum_id}/modes").content)
    assert len(modes["joint_of_bone"]) == len(tensors["turn_parent"])
    assert modes["bone_of_voxel"].max() < len(tensors["turn_parent"])
    again = load(client.get(f"/v1/spectra/{spectrum_id}/surface").content)
    np.testing.assert_array_equal(again["turn_shapes"], tensors["turn_shapes"])
    less = served_id(client, grown.mesh, spectrum, tmp_path, new_id(), flutter=0.5)
    again = load(client.get(f"/v1/spectra/{less}/surface").content)
    assert again["flutter_share"].max() == tensors["flutter_share"].max() / 2 > 0


def test_mode_shapes_of_voxels_are_left_out_where_they_are_not_wanted(client, spectrum_id: str, spectrum) -> None:
    path = f"/v1/spectra/{spectrum_id}/modes"
    whole, small = (load(client.get(path, params={"shapes": shapes}).content) for shapes in ("true", "false"))
    assert whole.keys() - small.keys() == LARGE
    np.testing.assert_array_equal(whole["lean_m"], spectrum.coefficients[:, 0].real)


@pytest.mark.parametrize("kind", ["surface", "modes"])
def test_what_a_viewer_loads_is_packed_for_whoever_takes_it(client: TestClient, spectrum_id: str, kind: str) -> None:
    path = f"/v1/spectra/{spectrum_id}/{kind}"
    plain = client.get(path, headers={"Accept-Encoding": "identity"})
    packed = client.get(path, headers={"Accept-Encoding": "br, gzip"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert plain.headers["vary"] == packed.headers["vary"] == "Accept-Encoding"
    assert int(packed.headers["content-length"]) < int(plain.headers["content-length"]) == len(plain.content)
    whole, unpacked = load(plain.content), load(packed.content)  # the order of metadata is left to chance
    assert whole.keys() == unpacked.keys()
    for name in whole:
        np.testing.assert_array_equal(whole[name], unpacked[name])


def test_serve_tells_of_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    ready = b'{"workers": "ok", "housekeeper": "ok"}'
    with answering(lambda _, handler: handler.reply(200, ready)) as line:
        url = line.url.replace("127.0.0.1", "0.0.0.0")
        assert print_when_ready(url)
    assert capsys.readouterr().out.splitlines() == [f"ready {url}", f"A page to use it from: {line.url}/"]


def test_only_sites_of_the_list_may_frame_the_embedded_tree(settings: Settings) -> None:
    with TestClient(create_app(settings.model_copy(update={"embed_origins": ("https://a.example",)}))) as client:
        embedded, page = client.get("/embed"), client.get("/")
    assert "frame-ancestors 'self' https://a.example" in embedded.headers["Content-Security-Policy"].split("; ")
    assert "X-Frame-Options" not in embedded.headers
    assert "frame-ancestors 'none'" in page.headers["Content-Security-Policy"].split("; ")
    assert page.headers["X-Frame-Options"] == "DENY"


@pytest.mark.parametrize("origin", ["https://a.example; script-src *", "a.example", "javascript:"])
def test_an_origin_that_is_none_is_refused(tmp_path: Path, origin: str) -> None:
    with pytest.raises(ValidationError, match="embed_origins"):
        Settings(state_dir=tmp_path, embed_origins=(origin,))


def test_any_site_may_load_the_element_and_nothing_else(client: TestClient) -> None:
    element = client.get("/web/embed/dynamic-tree.js")
    assert element.headers["Access-Control-Allow-Origin"] == "*"
    assert element.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
    assert "Access-Control-Allow-Origin" not in client.get("/web/embed/page.js").headers
