"""Leaf cards on the page keep their size in a storm, where a sum of modes lets them grow."""

from collections.abc import Callable

import httpx
import numpy as np
import pytest

from tests.browser.conftest import Viewer

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

Open = Callable[..., Viewer]
GALE_GAIN = 7.0  # of the drag from 5 to 20 m/s
TURN_RAD = 0.7
POINTS = """async ({ path, gain, turn, rigid }) => {
    const load = (path) => import(`/web/${path}.js`);
    const THREE = await import("three");
    const names = ["draw/surface", "draw/field", "draw/cards", "motion/modes", "motion/vertex"];
    const [{ readSurface }, { Field, DISPLACE }, { setCards, noCards, CARDS }, { windCoordinates }, { vertexInWind }] =
        await Promise.all(names.map(load));
    const file = await fetch(path);
    const surface = await readSurface(await file.arrayBuffer());
    const { geometry, N, scale_m, shapes } = surface;
    const restAt = { value: setCards(surface) };
    if (!rigid) geometry.setAttribute("cardRows", noCards(N));
    const renderer = new THREE.WebGLRenderer();
    const field = new Field(shapes, scale_m, N);
    const q = windCoordinates(scale_m.length, 0.3, Array(scale_m.length).fill(gain));
    field.evaluate(renderer, q, turn);
    const side = Math.ceil(Math.sqrt(N));
    const target = new THREE.WebGLRenderTarget(side, side, { type: THREE.FloatType });
    const material = new THREE.ShaderMaterial({
        uniforms: { moved: { value: field.texture }, restAt, bent: { value: 0 }, poses: { value: null } },
        vertexShader: `${DISPLACE}\\n${CARDS}\\nvarying vec3 at;
            void main() {
                at = position + cardMoved(movedAt(gl_VertexID).xyz);
                vec2 pixel = vec2(gl_VertexID % ${side}, gl_VertexID / ${side}) + 0.5;
                gl_Position = vec4(2.0 * pixel / ${side}.0 - 1.0, 0.0, 1.0);
                gl_PointSize = 1.0;
            }`,
        fragmentShader: "varying vec3 at; void main() { gl_FragColor = vec4(at, 1.0); }",
    });
    geometry.setIndex(null);
    geometry.clearGroups();
    const points = new THREE.Points(geometry, material);
    points.frustumCulled = false;
    const scene = new THREE.Scene();
    scene.add(points);
    renderer.setRenderTarget(target);
    renderer.render(scene, new THREE.Camera());
    const texels = new Float32Array(4 * side * side);
    renderer.readRenderTargetPixels(target, 0, 0, side, side, texels);
    const unbent = { surface: { ...surface, turn_parent: null } };
    const byOne = Array.from({ length: N }, (_, v) => vertexInWind(unbent, v, q, turn));
    return { texels: [...texels.subarray(0, 4 * N)], byOne: byOne.flat(), rest: [...surface.vertices],
             faces: [...surface.faces], rows: [...geometry.attributes.cardRows.array] };
}"""


def areas(faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def test_cards_keep_their_size_in_a_storm(view: Open, url: str, job_id: str) -> None:
    viewer = view(640, 480)
    viewer.open(url)
    page = viewer.page
    spectrum = httpx.get(f"{url}/v1/jobs/{job_id}").json()["result"]["spectrum_id"]
    growth = {}
    for rigid in (True, False):
        given = {"path": f"/v1/spectra/{spectrum}/surface", "gain": GALE_GAIN, "turn": TURN_RAD, "rigid": rigid}
        answer = page.evaluate(POINTS, given)
        rest, moved = (np.array(answer[name]).reshape(-1, size) for name, size in (("rest", 3), ("texels", 4)))
        faces = np.array(answer["faces"]).reshape(-1, 3)
        by_one = rest + np.array(answer["byOne"]).reshape(-1, 3)
        assert np.abs(by_one - moved[:, :3]).max() < 1e-3 * np.abs(moved[:, :3] - rest).max(), "one vertex alone"
        if rigid:
            rows = np.array(answer["rows"]).reshape(-1, 3).astype(int)
            in_card, bent = rows[faces[:, 0], 0] >= 0, moved
            assert in_card.mean() > 0.1  # its leaves; branches bend
        faces = faces[in_card]
        before = areas(faces, rest)
        large = before > np.median(before) / 10
        growth[rigid] = np.percentile(np.abs(areas(faces, moved[:, :3])[large] / before[large] - 1), 99)
    hung = rows[rows[:, 0] >= 0, 0]
    gap = np.linalg.norm(bent[hung, :3] - moved[hung, :3], axis=1).max()
    assert growth[True] < 0.001
    assert growth[False] > 0.1
    assert gap < 1e-5
