// Where a tree stands: camera, light, ground. +Z is up, metres, as everywhere in the service.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FIELD_OF_VIEW = 30;
const SUN = new THREE.Vector3(0.55, -0.62, 1.0).normalize();
const LOOKS = {
  light: { sky: 0xf4f8ff, earth: 0xb9b09a, ambient: 1.35, sun: 0xfff1dc, strength: 2.7, ground: 0xdcdccf, shadow: 0.3 },
  dark: { sky: 0xb4c8e2, earth: 0x3a3f3c, ambient: 1.25, sun: 0xe9efff, strength: 2.6, ground: 0x2b353c, shadow: 0.5 },
};

export class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({
      canvas,
      antialias: true,
      alpha: true,
      powerPreference: "high-performance",
    });
    if (!this.renderer.extensions.has("EXT_color_buffer_float"))
      throw new Error("this browser's WebGL cannot draw into textures of floating-point numbers");
    this.renderer.setPixelRatio(Math.min(globalThis.devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.05, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, {
      enableDamping: true,
      dampingFactor: 0.12,
      maxPolarAngle: Math.PI * 0.495,
      enablePan: false,
      rotateSpeed: 0.7,
    });
    this.controls.addEventListener("change", () => {
      this.stale = true;
    });
    this._light();
    this._ground();
    this.frame({ min: new THREE.Vector3(-3, -3, 0), max: new THREE.Vector3(3, 3, 9) });
    this.margins = { right: 0, bottom: 0, top: 0 };
    this.stale = true;
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  _light() {
    this.sky = new THREE.HemisphereLight();
    this.sky.position.set(0, 0, 1);
    this.sun = new THREE.DirectionalLight();
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.radius = 3;
    this.scene.add(this.sky, this.sun, this.sun.target);
  }

  _ground() {
    const picture = document.createElement("canvas");
    picture.width = picture.height = 256;
    const pen = picture.getContext("2d");
    const fade = pen.createRadialGradient(128, 128, 0, 128, 128, 128);
    for (const [at, alpha] of [
      [0, 1],
      [0.35, 0.85],
      [0.7, 0.3],
      [1, 0],
    ])
      fade.addColorStop(at, `rgba(255,255,255,${alpha})`);
    pen.fillStyle = fade;
    pen.fillRect(0, 0, 256, 256);
    const disc = new THREE.CircleGeometry(1, 96);
    this.ground = new THREE.Mesh(
      disc,
      new THREE.MeshBasicMaterial({ map: new THREE.CanvasTexture(picture), transparent: true, depthWrite: false }),
    );
    this.shade = new THREE.Mesh(disc, new THREE.ShadowMaterial({ transparent: true, depthWrite: false }));
    this.shade.receiveShadow = true;
    this.ground.renderOrder = -2;
    this.shade.renderOrder = -1;
    this.arrow = windArrow();
    this.scene.add(this.ground, this.shade, this.arrow);
  }

  look(name) {
    const look = LOOKS[name];
    this.sky.color.set(look.sky);
    this.sky.groundColor.set(look.earth);
    this.sky.intensity = look.ambient;
    this.sun.color.set(look.sun);
    this.sun.intensity = look.strength;
    this.ground.material.color.set(look.ground);
    this.shade.material.opacity = look.shadow;
    this.stale = true;
  }

  /** Put camera, ground and shadow around a box. */
  frame({ min, max }) {
    const centre = new THREE.Vector3().addVectors(min, max).multiplyScalar(0.5);
    const size = new THREE.Vector3().subVectors(max, min);
    this.box = { min: min.clone(), max: max.clone() };
    this.height = size.z;
    const radius = 0.5 * Math.max(size.length(), 0.1);
    this.radius = radius;
    this.middle = centre.clone();
    this.ground.position.set(centre.x, centre.y, min.z - 0.002 * size.z);
    this.shade.position.copy(this.ground.position);
    this.ground.scale.setScalar(radius * 2.3);
    this.shade.scale.setScalar(radius * 2.3);
    this.arrow.position.set(centre.x, centre.y, min.z);
    this.arrow.scale.setScalar(radius);
    this.sun.target.position.copy(centre);
    this.sun.position.copy(centre).addScaledVector(SUN, 4 * radius);
    const eye = this.sun.shadow.camera;
    Object.assign(eye, {
      left: -1.25 * radius,
      right: 1.25 * radius,
      top: 1.25 * radius,
      bottom: -1.25 * radius,
      near: radius,
      far: 8 * radius,
    });
    eye.updateProjectionMatrix();
    this.sun.shadow.normalBias = radius * 0.012;
    this.sun.shadow.bias = -0.0008;
    this.home();
  }

  /** Look at the tree as at first. */
  home() {
    const free = this.free ?? { width: 1, height: 1 };
    const half = Math.tan(THREE.MathUtils.degToRad(FIELD_OF_VIEW / 2));
    const [wide, tall] = [this.box.max.clone().sub(this.box.min), this.height];
    const across = Math.max(wide.x, wide.y, Math.hypot(wide.x, wide.y) * 0.85);
    const distance =
      Math.max((0.55 * tall) / half, ((0.55 * across) / half) * (free.height / free.width)) + 0.3 * across;
    this.controls.target.copy(this.middle);
    this.camera.position.copy(this.middle).add(new THREE.Vector3(-0.38, -1, 0.2).normalize().multiplyScalar(distance));
    this.controls.minDistance = 0.3 * this.radius;
    this.controls.maxDistance = 6 * distance;
    this.camera.near = distance / 200;
    this.camera.far = distance * 20;
    this.controls.update();
    this.resize();
  }

  /** Turn by keys [rad]; zoom is a factor of the distance. */
  orbit(around, up, zoom = 1) {
    const offset = new THREE.Vector3().subVectors(this.camera.position, this.controls.target);
    const flat = Math.hypot(offset.x, offset.y);
    const angle = Math.atan2(offset.y, offset.x) + around;
    const lift = THREE.MathUtils.clamp(Math.atan2(offset.z, flat) + up, 0.02, 1.5);
    const length = THREE.MathUtils.clamp(offset.length() * zoom, this.controls.minDistance, this.controls.maxDistance);
    offset
      .set(Math.cos(angle) * Math.cos(lift), Math.sin(angle) * Math.cos(lift), Math.sin(lift))
      .multiplyScalar(length);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.stale = true;
  }

  /** Parts of the canvas that panels lie over [px]: the tree stands in the middle of what is left. */
  clear(margins) {
    if (JSON.stringify(margins) === JSON.stringify(this.margins)) return;
    this.margins = margins;
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const size = this.renderer.getSize(new THREE.Vector2());
    if (size.x !== width || size.y !== height) this.renderer.setSize(width, height, false);
    const { right = 0, bottom = 0, top = 0 } = this.margins ?? {};
    const before = this.free;
    this.free = { width: Math.max(width - right, 1), height: Math.max(height - bottom - top, 1) };
    this.camera.aspect = this.free.width / this.free.height;
    // the camera sees the free part; the view offset adds what lies around it
    this.camera.setViewOffset(this.free.width, this.free.height, 0, -top, width, height);
    this.camera.updateProjectionMatrix();
    this.stale = true;
    if (!before || Math.abs(before.width / before.height - this.camera.aspect) > 0.25) this.home();
  }

  /** Where a place in the window is on the canvas, -1 to 1. */
  pointer(event) {
    const box = this.canvas.getBoundingClientRect();
    return new THREE.Vector2(
      ((event.clientX - box.left) / box.width) * 2 - 1,
      1 - ((event.clientY - box.top) / box.height) * 2,
    );
  }

  /** Pixels of a point in the window. */
  onScreen(point) {
    const at = new THREE.Vector3(...point).project(this.camera);
    const box = this.canvas.getBoundingClientRect();
    return { x: box.left + ((at.x + 1) / 2) * box.width, y: box.top + ((1 - at.y) / 2) * box.height };
  }

  wind(direction_deg, strength, colour) {
    this.arrow.rotation.z = THREE.MathUtils.degToRad(direction_deg);
    this.arrow.visible = strength > 0;
    this.arrow.material.color.set(colour);
    this.arrow.material.opacity = 0.35 + 0.5 * Math.min(strength, 1);
    this.stale = true;
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
    this.stale = false;
  }
}

/** Three chevrons on the ground before the tree, pointing along +X. */
function windArrow() {
  const places = [];
  for (let i = 0; i < 3; i++) {
    const x = 0.84 + 0.085 * i;
    const wing = 0.045;
    const thick = 0.03;
    for (const side of [1, -1]) {
      const tip = [x, 0];
      const tipBack = [x - thick * 1.5, 0];
      const end = [x - wing, side * wing];
      const endBack = [x - wing - thick * 1.5, side * wing];
      for (const [a, b, c] of [
        [tip, end, tipBack],
        [tipBack, end, endBack],
      ])
        for (const p of [a, b, c]) places.push(p[0], p[1], 0);
    }
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(places), 3));
  const arrow = new THREE.Mesh(
    geometry,
    new THREE.MeshBasicMaterial({ transparent: true, side: THREE.DoubleSide, depthWrite: false }),
  );
  arrow.visible = false;
  return arrow;
}
