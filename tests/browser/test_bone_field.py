"""The page bends a tree as the library does, in wind that has turned, in several copies and one vertex alone."""

import httpx
import numpy as np
from safetensors.numpy import load

from dynamictree.wind_bands import drag_at
from recipes.wind_reference import feet, half_turns, turned
from service.routes.surface import ZERO
from tests.browser.conftest import Open

STORM_GAIN = float(drag_at(np.float64(20.0)) / drag_at(np.float64(5.0)))
TURN_RAD = 0.7
DISPLACED = """async ({ path, q, turn }) => {
    const THREE = await import("three");
    const [{ readSurface }, { Field }, { displaced }] = await Promise.all(
        ["draw/surface", "draw/field", "motion/swing"].map((name) => import(`/web/${name}.js`)));
    const surface = await readSurface(await (await fetch(path)).arrayBuffer());
    const renderer = new THREE.WebGLRenderer();
    const still = q.map(() => 0);
    const own = new Field(surface);
    const copies = own.copied(2);
    own.swing([{ q, turn }]);
    copies.swing([{ q: still, turn: 0 }, { q, turn }]);
    for (const field of [own, copies]) field.render(renderer, { moved: {}, castMoved: {} });
    const read = (field, row) => {
        const texels = new Float32Array(4 * 2048 * field.rows);
        renderer.readRenderTargetPixels(field.target, 0, row * field.rows, 2048, field.rows, texels);
        return [...texels.subarray(0, 4 * surface.N)];
    };
    const byOne = Array.from({ length: surface.N }, (_, v) => [...displaced(surface, v, own.ofCopy[0]), 0]);
    return [read(own, 0), read(copies, 0), read(copies, 1), byOne.flat()];
}"""


def test_the_page_bends_as_the_library_does(view: Open, url: str, job_id: str) -> None:
    viewer = view(640, 480)
    viewer.open(url)
    with httpx.Client(base_url=url, timeout=60) as client:
        spectrum = client.get(f"/v1/jobs/{job_id}").json()["result"]["spectrum_id"]
        path = f"/v1/spectra/{spectrum}/surface"
        tensors = load(client.get(path).content)
    num_bins = tensors["turn_shapes"].shape[2]
    q = STORM_GAIN * np.exp(2j * np.pi * 0.3 * np.arange(num_bins))
    given = {"path": path, "q": np.stack([q.real, q.imag], axis=1).ravel().tolist(), "turn": TURN_RAD}
    there = np.array(viewer.page.evaluate(DISPLACED, given)).reshape(4, -1, 4)[:, :, :3]

    steps = np.tensordot([1, 256], tensors["turn_shapes"], 1) - ZERO
    modes = steps * tensors["turn_step_rad"][:, None, None, None].astype(np.float64)
    theta = np.einsum("bkc,k->bc", modes[..., 0] + 1j * modes[..., 1], q).real
    half = half_turns(theta, tensors["turn_direction"].astype(np.float64), TURN_RAD, np.zeros_like(theta))
    parent, foot = tensors["turn_parent"], tensors["turn_foot_m"].astype(np.float64)
    bone, share = tensors["turn_bone"], tensors["turn_share"][:, None]
    arm = tensors["vertices"] - foot[bone]
    by_parent = turned(half[np.maximum(parent, 0)[bone]], arm)
    expected = feet(half, foot, parent)[bone] + (1 - share) * turned(half[bone], arm) + share * by_parent - arm
    assert np.linalg.norm(expected, axis=1).max() > 0.1
    for moved in there[[0, 2, 3]]:
        assert np.abs(moved - expected).max() < 1e-3 * np.abs(expected).max()
    assert np.abs(there[1]).max() == 0

    start, end = tensors["faces"][:, 0], tensors["faces"][:, 1]
    rest = np.linalg.norm(tensors["vertices"][start] - tensors["vertices"][end], axis=1)
    now = tensors["vertices"] + there[0]
    longer = np.abs(np.linalg.norm(now[start] - now[end], axis=1) / np.maximum(rest, 1e-9) - 1)
    assert np.percentile(longer[rest > 0], 99) < 0.04
