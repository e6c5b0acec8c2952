// The stage in a headset or a phone's camera (WebXR): the tree in its true size, some steps away.

import * as THREE from "three";

const AWAY = 0.9; // of the tree's height and width, from its middle
const NEAREST_M = 1.2;

const modeOf = (kind) => (kind === "ar" ? "immersive-ar" : "immersive-vr");

/** Whether the browser can show "vr" or "ar". */
export const canShow = async (kind) =>
  Boolean(await globalThis.navigator.xr?.isSessionSupported(modeOf(kind)).catch(() => false));

/** Show the stage until the session ends; `onSelect()` is called where a hand, a trigger or a finger selects. */
export async function immerse(stage, kind, { onSelect = () => {} } = {}) {
  const { renderer, camera, scene, box, surroundings } = stage;
  const session = await navigator.xr.requestSession(modeOf(kind), { optionalFeatures: ["local-floor"] });
  const seen = camera.clone();
  const [ground, sky] = [surroundings.ground.visible, surroundings.backdrop.visible];
  const floor = new THREE.Group(); // a session's +Y is up, and its wearer looks along -Z
  const size = box.getSize(new THREE.Vector3());
  const middle = box.getCenter(new THREE.Vector3());
  const away = Math.max(AWAY * Math.max(size.x, size.y, size.z), NEAREST_M + size.y / 2);
  floor.position.set(middle.x, middle.y - away, box.min.z);
  floor.rotation.x = Math.PI / 2;
  floor.add(camera);
  scene.add(floor);
  surroundings.ground.visible = ground && kind === "vr"; // a room has its own
  surroundings.backdrop.visible = false;
  renderer.xr.enabled = true;
  session.addEventListener("select", onSelect);
  session.addEventListener("end", () => {
    renderer.xr.enabled = false;
    floor.removeFromParent();
    floor.remove(camera);
    camera.copy(seen);
    surroundings.ground.visible = ground;
    surroundings.backdrop.visible = sky;
    stage.resize();
    stage.controls.update();
  });
  renderer.xr.setReferenceSpaceType("local-floor");
  await renderer.xr.setSession(session);
}
