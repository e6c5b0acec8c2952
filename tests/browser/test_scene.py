"""What stands around the tree: other trees, light and background."""

from collections.abc import Callable
from math import sin
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser.conftest import Open, Viewer, animated, changed, scrub, steady
from tests.browser.test_viewer import on_the_tree


@pytest.fixture
def paused(view: Open, url: str, job_id: str) -> Viewer:
    """The tree of a job that has ended; its playback is paused."""
    viewer = view(900, 620)
    viewer.show(f"{url}/#job={job_id}")
    viewer.page.locator("#play").click()
    return viewer


def test_a_second_wind_and_a_forest_stand_beside_the_tree(paused: Viewer) -> None:
    viewer, page = paused, paused.page
    steady(viewer)
    alone = scrub(viewer, 0.0)
    page.locator("#company input[value=pair]").check(force=True)
    expect(page.locator("#other-speed")).to_have_attribute("aria-valuetext", "12.0 m/s")
    pair = steady(viewer)
    expect(page.locator("#plates span")).to_have_text(["5.0 m/s", "12.0 m/s"])
    assert changed(alone, pair) > 0.02
    page.locator("#other-speed").fill("0")
    assert changed(pair, steady(viewer)) > 0.002, "the other tree has the same wind"
    page.locator("#company input[value=forest]").check(force=True)
    forest = scrub(viewer, 0.0)
    assert changed(forest, scrub(viewer, 0.5)) > 0.004
    assert changed(forest, scrub(viewer, 1.0)) == 0, "the forest's loop does not close"
    page.locator("#company input[value=one]").check(force=True)
    assert changed(alone, scrub(viewer, 0.0)) == 0, "the tree is not as before"


def test_shadows_can_be_switched_off(paused: Viewer) -> None:
    viewer, page = paused, paused.page
    steady(viewer)
    shaded = scrub(viewer, 0.0)
    page.locator("#light-section summary").click()
    page.locator("#shadows").uncheck(force=True)
    lit = steady(viewer)
    assert changed(shaded, lit) > 0.01
    assert lit.mean() > shaded.mean()
    page.locator("#shadows").check(force=True)
    assert changed(shaded, steady(viewer)) == 0


def test_software_looks_up_a_shadow_once_and_takes_no_power(view: Open, url: str) -> None:
    (viewer := view(640, 480)).open(url)
    chunks = viewer.page.evaluate("async () => (await import('three')).ShaderChunk")
    assert "shadow = texture(shadowMap, shadowCoord.xyz)" in chunks["shadowmap_pars_fragment"]
    assert "pow" not in chunks["colorspace_pars_fragment"].split("sRGBTransferOETF")[1].split("}")[0]


# Before each turn that draws the shadow map anew: shares of the tree's pixels that are darker than with a map of this
# moment, as they are drawn and with the old map looked up at the present place
SHADOWS = """async (every) => {
    const { Hand } = await import("/web/page/hand.js");
    const { tick } = Hand.prototype;
    const shares = [];
    const darker = (drawn, fresh) => {
        let all = 0, dark = 0;
        for (let i = 0; i < fresh.length; i += 4) {
            all += fresh[i + 3] > 0;
            dark += fresh[i + 1] - drawn[i + 1] > 24;
        }
        return dark / all;
    };
    return new Promise((done) => {
        Hand.prototype.tick = function () {
            const { stage, tree } = this, { resolution, renderer, scene, surroundings } = stage;
            Object.defineProperty(resolution, "shadowEvery", { value: every, configurable: true });
            if (resolution.frame % every === every - 1) {
                const around = ["ground", "backdrop", "arrow"].map((name) => surroundings[name]);
                const shown = around.filter(({ visible }) => visible);
                for (const each of shown) each.visible = false;
                const draw = () => {
                    renderer.render(scene, stage.camera);
                    const gl = renderer.getContext(), [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
                    const bytes = new Uint8Array(4 * width * height);
                    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
                    return bytes;
                };
                const drawn = draw(), { castMoved, castPoses, castBent, moved, poses, bent } = tree.uniforms;
                const cast = [castMoved, castPoses, castBent], before = cast.map(({ value }) => value);
                [moved, poses, bent].forEach(({ value }, i) => { cast[i].value = value; });
                const flown = draw();
                renderer.shadowMap.needsUpdate = true;
                const fresh = draw();
                cast.forEach((uniform, i) => { uniform.value = before[i]; });
                for (const each of shown) each.visible = true;
                shares.push([darker(drawn, fresh), darker(flown, fresh)]);
            }
            if (shares.length === 12) done(shares, (Hand.prototype.tick = tick));
            tick.call(this);
        };
    });
}"""


def test_no_old_shadow_lies_on_a_tree_in_a_storm_or_in_a_hand(view: Open, url: str, samples: Path) -> None:
    job = animated(url, samples / "mesh/quaternius_common_tree/CommonTree_2.obj")
    viewer = view(700, 520)
    viewer.show(f"{url}/#job={job}")
    viewer.page.locator("#wind-presets button", has_text="Storm").click()
    viewer.page.wait_for_timeout(3000)
    assert_follows(viewer, 12, 0.008, lambda: None)
    viewer.page.locator("#speed").fill("0")
    viewer.page.wait_for_timeout(3000)
    x, y = on_the_tree(viewer)
    viewer.page.mouse.down()

    def shake() -> None:
        for step in range(100):
            viewer.page.mouse.move(x + 60 * sin(step / 3), y + 20)
            viewer.wait_turns(1)

    assert_follows(viewer, 8, 0.03, shake)


def assert_follows(viewer: Viewer, every: int, tolerance: float, move: Callable[[], None]) -> None:
    viewer.page.evaluate(f"() => {{ window.shares = ({SHADOWS})({every}); }}")
    move()
    as_drawn, at_the_present_place = zip(*viewer.page.evaluate("window.shares"), strict=True)
    assert max(at_the_present_place) > 2 * tolerance, "nothing flew into its shadow"
    assert max(as_drawn) < tolerance, as_drawn


def test_the_sun_moves_and_the_background_goes(paused: Viewer, tmp_path: Path) -> None:
    viewer, page = paused, paused.page
    before = steady(viewer)
    page.locator("#light-section summary").click()
    page.locator("#sun-from").fill("135")
    page.locator("#sun-height").fill("20")
    expect(page.locator("#sun-from")).to_have_attribute("aria-valuetext", "135° NW")
    assert changed(before, steady(viewer)) > 0.01, "the shadow stays where it was"
    page.locator("#background").select_option("none")
    with page.expect_download() as sent:
        page.locator("#save-picture").click()
    sent.value.save_as(tmp_path / "view.png")
    with Image.open(tmp_path / "view.png") as picture:
        assert picture.getpixel((2, 2))[3] == 0


SEEN = """async (still) => {
    const { seenBox } = await import("/web/draw/surface.js");
    const { Box3, Vector3 } = await import("three");
    const plant = [[-1, -1, 0], [1, 1, 4]];
    const vertices = new Float32Array([...plant, ...still].flat());
    const whole = new Box3().setFromPoints([...plant, ...still].map((point) => new Vector3(...point)));
    const marks = new Uint8Array([...plant.map(() => 0), ...still.map(() => 1)]);
    const { min, max } = seenBox({ vertices, still: still.length ? marks : undefined, N: marks.length }, whole);
    return [min.toArray(), max.toArray()];
}"""


def test_the_view_holds_the_plant_with_its_pot_and_not_the_sea_around_it(view: Open, url: str) -> None:
    viewer = view(640, 480)
    viewer.open(url)
    assert viewer.page.evaluate(SEEN, []) == [[-1, -1, 0], [1, 1, 4]]
    assert viewer.page.evaluate(SEEN, [[-0.5, -0.5, -0.8], [0.5, 0.5, 0.1]]) == [[-1, -1, -0.8], [1, 1, 4]]
    low, high = viewer.page.evaluate(SEEN, [[-200, -200, -0.2], [200, 200, -0.2]])
    assert (low[2], high[2]) == pytest.approx((-0.2, 4))
    assert -3.5 < low[0] < -1 < 1 < high[0] < 3.5
