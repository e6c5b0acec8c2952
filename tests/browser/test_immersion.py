"""A headset and a phone's camera, by an emulator of WebXR; files for phones that have none; the sound of leaves."""

import pytest
from playwright.sync_api import expect

from tests.browser.conftest import AXE, JOB_MS, MOVING, Open

EMULATOR = AXE.parents[1] / "iwer/build/iwer.min.js"
HEADSET = "new IWER.XRDevice(IWER.metaQuest3).installRuntime({ polyfillLayers: false, forceInstall: true });"
SEEN = """async () => {
    const { stage, scene } = await (await import("/web/page/early.js")).page;
    const { Vector3 } = await import("three");
    const eye = stage.renderer.xr.getCamera();
    const at = new Vector3().setFromMatrixPosition(eye.matrixWorld);
    const ahead = new Vector3(0, 0, -1).transformDirection(eye.matrixWorld);
    return { frames: Number(document.body.dataset.frames), immersed: stage.immersed,
        at: at.toArray(), ahead: ahead.toArray(), low: scene.tree.box.min.toArray(), high: scene.tree.box.max.toArray(),
        view: stage.camera.position.toArray(), ground: stage.surroundings.ground.visible };
}"""
END = "async () => (await (await import('/web/page/early.js')).page).stage.renderer.xr.getSession().end()"


@pytest.mark.skipif(not EMULATOR.is_file(), reason="the emulator is not installed: make js-tools")
@pytest.mark.parametrize("kind", ["vr", "ar"])
def test_the_tree_stands_in_its_true_size_before_who_wears_a_headset(view, url, job_id, kind) -> None:
    viewer = view(900, 620)
    page = viewer.page
    page.add_init_script(EMULATOR.read_text() + HEADSET)
    page.goto(f"{url}/#job={job_id}")
    page.wait_for_selector(MOVING, state="attached", timeout=JOB_MS)
    before = page.evaluate(SEEN)
    page.locator(f"#show-{kind}").click()
    page.wait_for_function("async () => (await (await import('/web/page/early.js')).page).stage.immersed")
    start = viewer.frames
    page.wait_for_function("(start) => Number(document.body.dataset.frames) > start + 5", arg=start)
    seen = page.evaluate(SEEN)
    (x, y, z), low, high = seen["at"], seen["low"], seen["high"]
    assert seen["immersed"]
    assert z - low[2] == pytest.approx(1.6, abs=0.2), "the eyes of who stands on the tree's ground"
    assert y < low[1] - 0.5, "the wearer stands in the tree"
    assert low[0] < x < high[0]
    assert seen["ahead"] == pytest.approx([0, 1, 0], abs=0.05)
    assert seen["ground"] == (kind == "vr"), "a room has its own"
    page.evaluate(END)
    page.wait_for_function("async () => !(await (await import('/web/page/early.js')).page).stage.immersed")
    viewer.wait_frames(2)
    after = page.evaluate(SEEN)
    assert after["view"] == pytest.approx(before["view"], abs=0.01)
    assert after["ground"]


def test_without_webxr_no_headset_is_offered_and_phones_get_files(view: Open, url: str) -> None:
    viewer = view(900, 620)
    viewer.open(url)
    assert viewer.page.locator("#show-vr").is_hidden()
    assert viewer.page.locator("#show-ar").is_hidden()
    formats, apple, android = viewer.page.evaluate("""async () => {
        const { addressFor, phoneFormat } = await import("/web/page/immersion.js");
        const [knows, other] = [true, false].map((ar) => ({ relList: { supports: () => ar } }));
        const android = { userAgent: "Mozilla/5.0 (Linux; Android 15)" };
        const file = new URL("https://trees.example/v1/artifacts/A?filename=oak.glb");
        return [[phoneFormat(knows, {}), phoneFormat(other, android), phoneFormat(other, { userAgent: "X11" })],
            addressFor("usd-skinned", file, "Oak"), addressFor("glb", file, "Oak & ash")];
    }""")
    assert formats == ["usd-skinned", "glb", None]
    assert apple == "https://trees.example/v1/artifacts/A?filename=oak.glb"
    assert android.startswith("intent://arvr.google.com/scene-viewer/1.0?file=https%3A%2F%2Ftrees.example%2Fv1")
    assert "title=Oak+%26+ash#Intent;scheme=https;" in android


def test_leaves_are_louder_in_more_wind_and_silent_without(view: Open, url: str) -> None:
    viewer = view(900, 620)
    viewer.open(url)
    expect(viewer.page.locator("#sound")).not_to_be_checked()
    loudness = viewer.page.evaluate("""async () => {
        const { rustle } = await import("/web/page/sound.js");
        return Promise.all([0, 1, 5].map(async (motion) => {
            const context = new OfflineAudioContext(1, 96_000, 48_000);
            rustle(context)(motion);
            const heard = (await context.startRendering()).getChannelData(0).slice(48_000);
            return Math.sqrt(heard.reduce((sum, x) => sum + x * x, 0) / heard.length);
        }));
    }""")
    silent, breeze, storm = loudness
    assert silent == 0
    assert 0.01 < breeze < 0.7 * storm
    assert storm < 0.3
