// Where a tree stands: renderer, camera and surroundings. +Z is up, metres, as everywhere in the service.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Resolution } from "./resolution.js";
import { contextOf, lightenShaders } from "./software.js";
import { Surroundings } from "./surroundings.js";

const FIELD_OF_VIEW = 30;
const ROUND = Math.SQRT1_2 / 2; // corners of the square in a crown's circle, in shares of its width
const FILLED = 0.94; // of the free part's half
const OTHER_ASPECT = 0.15; // of width by height: with so much more or less, the first view is another
const FIRST_VIEW = new THREE.Vector3(-0.38, -1, 0.2).normalize();

export class Stage {
  /** `onContext(lost)` is called when the graphics context is lost and when it is back. */
  constructor(first, { onContext = () => {} } = /** @type {any} */ ({})) {
    const { canvas, context, soft } = contextOf(first);
    this.canvas = canvas;
    this.soft = soft;
    if (!context) throw new Error("this browser has no WebGL 2");
    this.renderer = new THREE.WebGLRenderer({ canvas, context, stencil: true });
    this.renderer.debug.checkShaderErrors = false; // each of its questions waits for the card; WebGL itself warns
    if (!this.renderer.extensions.has("EXT_color_buffer_float")) {
      throw new Error("this browser's WebGL cannot draw into textures of floating-point numbers");
    }
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.shadowMap.autoUpdate = false;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.05, 1000);
    this.camera.up.set(0, 0, 1);
    if (soft) lightenShaders();
    this.surroundings = new Surroundings(this.scene);
    this.resolution = new Resolution(soft ? 2 : 1, soft);
    this.margins = { left: 0, right: 0, bottom: 0, top: 0 };
    this.stale = true; // the picture on the screen is not the scene any more
    this.prepare = (_renderer) => {}; // before each draw
    this._setControls();
    this.frame({ min: new THREE.Vector3(-3, -3, 0), max: new THREE.Vector3(3, 3, 9) });
    canvas.addEventListener("webglcontextlost", () => onContext(true));
    canvas.addEventListener("webglcontextrestored", () => {
      this.stale = true;
      onContext(false);
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  _setControls() {
    this.controls = new OrbitControls(this.camera, this.canvas);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, rotateSpeed: 0.7, autoRotateSpeed: 1.5 });
    Object.assign(this.controls, { maxPolarAngle: Math.PI * 0.495, screenSpacePanning: true });
    this.controls.addEventListener("change", () => {
      this.stale = true;
    });
  }

  /** Of a theme, and in software before a `sky` in two colours of CSS; null leaves that to the page. */
  look(theme, sky = null) {
    this.surroundings.look(theme);
    this.surroundings.backdrop.look(this.soft && sky);
    this.stale = true;
  }

  wind(direction_deg, strength, colour) {
    this.surroundings.wind(direction_deg, strength, colour);
    this.stale = true;
  }

  /** See Surroundings.sunPlace. */
  moveSun(place) {
    this.surroundings.sunPlace = place;
    this.stale = true;
  }

  // ---- camera

  /** Put camera, ground and shadow around a box. */
  frame({ min, max }) {
    this.box = new THREE.Box3(min.clone(), max.clone());
    this.seen = this.box; // and what stands beside the tree
    this.middle = new THREE.Vector3().addVectors(min, max).multiplyScalar(0.5);
    const half = new THREE.Vector3().subVectors(max, min).multiplyScalar(0.5);
    this.radius = half.length();
    this.height = max.z - min.z;
    this.surroundings.frame(this.middle, half, this.radius, min.z);
    this.home();
  }

  /** Look at what is in a box beside the tree as well; null for the tree alone. */
  seeAlso(box) {
    const seen = box ? this.box.clone().union(box) : this.box;
    if (seen.equals(this.seen)) return;
    this.seen = seen;
    this.home();
  }

  /** Look at the tree as at first. */
  home() {
    const { width, height } = this.free ?? { width: 1, height: 1 };
    this.aspect = width / height; // that this view is made for
    const half = Math.tan(THREE.MathUtils.degToRad(FIELD_OF_VIEW / 2));
    const wide = this.seen.getSize(new THREE.Vector3());
    const across = Math.max(wide.x, wide.y, Math.hypot(wide.x, wide.y) * 0.85);
    const tall = (0.55 * wide.z) / half;
    const upright = Math.max(tall, (0.55 * across) / half / this.aspect) + 0.3 * across;
    const distance = Math.max(upright, this._distanceOfWhole(wide, half, this.aspect));
    this.halfWidth = distance * half * this.aspect; // of what is seen beside the middle [m]
    this.surroundings.bringArrowNear(this.halfWidth);
    const middle = this.seen.getCenter(this.controls.target);
    this.camera.position.copy(middle).addScaledVector(FIRST_VIEW, distance);
    this.controls.minDistance = 0.3 * this.radius;
    this.controls.maxDistance = 6 * distance;
    this.camera.near = distance / 200;
    this.camera.far = distance * 20;
    this.controls.update();
    this.resize();
  }

  /** So far the first view sees the whole of a round crown of this size: what is low and wide reaches towards the camera. */
  _distanceOfWhole(size, half, aspect) {
    const right = new THREE.Vector3(0, 0, 1).cross(FIRST_VIEW).normalize();
    const up = new THREE.Vector3().crossVectors(FIRST_VIEW, right);
    const corners = [-ROUND, ROUND].flatMap((x) => [-ROUND, ROUND].flatMap((y) => [-0.5, 0.5].map((z) => [x, y, z])));
    const needed = corners.map((shares) => {
      const at = new THREE.Vector3(...shares).multiply(size);
      const beside = Math.max(Math.abs(at.dot(right)) / aspect, Math.abs(at.dot(up)));
      return beside / (FILLED * half) + at.dot(FIRST_VIEW);
    });
    return Math.max(...needed);
  }

  /** Parts of the canvas that panels lie over [px]: the tree stands in the middle of the rest. */
  clear(margins) {
    if (JSON.stringify(margins) === JSON.stringify(this.margins)) return;
    this.margins = margins;
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this._setSize(width, height, this.resolution.scale);
    this.surroundings.backdrop.uniforms.share.value = height / globalThis.innerHeight;
    const { left = 0, right = 0, bottom = 0, top = 0 } = this.margins ?? {};
    this.free = { width: Math.max(width - left - right, 1), height: Math.max(height - bottom - top, 1) };
    this.camera.aspect = this.free.width / this.free.height;
    // the camera sees the free part; the view offset adds what lies around it
    this.camera.setViewOffset(this.free.width, this.free.height, -left, -top, width, height);
    this.camera.updateProjectionMatrix();
    this.stale = true;
    if (Math.abs(this.aspect - this.camera.aspect) > OTHER_ASPECT) this.home();
  }

  _setSize(width, height, scale) {
    if (this.immersed) return;
    const ratio = Math.min(globalThis.devicePixelRatio, 2) * scale;
    const size = this.renderer.getSize(new THREE.Vector2());
    if (size.x === width && size.y === height && this.renderer.getPixelRatio() === ratio) return;
    this.renderer.setDrawingBufferSize(width, height, ratio); // once: software waits for each new size
  }

  /** Where a place in the window is on the canvas, -1 to 1. */
  pointer(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * 2 - 1;
    return new THREE.Vector2(x, 1 - ((event.clientY - box.top) / box.height) * 2);
  }

  /** The pointer's place in a plane [m]; null where it looks along it. */
  onPlane(event, plane) {
    const caster = new THREE.Raycaster();
    caster.setFromCamera(this.pointer(event), this.camera);
    return caster.ray.intersectPlane(plane, new THREE.Vector3());
  }

  /** Pixels of a point in the window. */
  onScreen(point) {
    const at = new THREE.Vector3(...point).project(this.camera);
    const box = this.canvas.getBoundingClientRect();
    return { x: box.left + ((at.x + 1) / 2) * box.width, y: box.top + ((1 - at.y) / 2) * box.height };
  }

  // ---- drawing

  /** Whether a headset or a phone's camera shows it: it has a camera and pixels of its own. */
  get immersed() {
    return this.renderer.xr.isPresenting;
  }

  /** Draw if something has changed; an `empty` scene never in full, as it has no edges. Whether anything was drawn. */
  draw(now, empty = false) {
    if (this.immersed) {
      this._render(1, true);
      return true;
    }
    const full = !this.stale && !empty && this.resolution.settles(now);
    if ((!this.stale && !full) || this.renderer.getContext().isContextLost()) {
      this.resolution.pause();
      return false;
    }
    const shadow = full || this.resolution.next(now) || empty; // what has left takes its shadow along
    if (full) this.resolution.sharp = true;
    this._render(full ? this.resolution.stillScale : this.resolution.scale, shadow);
    return true;
  }

  /** Draw with all pixels, for a picture that is taken in the same turn. */
  drawNow() {
    const { arrow, backdrop } = this.surroundings;
    const shown = [arrow, backdrop].filter(({ visible }) => visible);
    for (const each of shown) each.visible = false; // a picture is of the tree
    this._render(1, true);
    for (const each of shown) each.visible = true;
    this.resolution.sharp = !shown.length; // the screen's own picture has them
  }

  _render(scale, shadow) {
    this._setSize(this.canvas.clientWidth, this.canvas.clientHeight, scale);
    this.renderer.shadowMap.needsUpdate = shadow;
    if (this.soft && shadow) this.surroundings.sun.shadow.mapSize.setScalar(scale < 1 ? 768 : 1024); // its pass costs by them
    this.prepare(this.renderer);
    this.stale = false;
    this.renderer.render(this.scene, this.camera);
  }
}
