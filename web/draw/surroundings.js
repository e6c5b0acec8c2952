// What stands around a tree: light, ground with shadow, and the arrow that the wind blows along.

import * as THREE from "three";
import { Ground } from "./ground.js";
import { Sky } from "./sky.js";

const SUN = { from_deg: 312, height_deg: 50 }; // +Y is north, 0° is east
const LOOKS = {
  light: { sky: 0xf4f8ff, earth: 0xb9b09a, ambient: 1.35, sun: 0xfff1dc, strength: 2.7, ground: 0xdcdccf, shadow: 0.3 },
  dark: { sky: 0xb4c8e2, earth: 0x3a3f3c, ambient: 1.25, sun: 0xe9efff, strength: 2.6, ground: 0x2b353c, shadow: 0.5 },
};
const SLACK = 0.012; // of the radius: so far a shadow stays off its surface
const AROUND = 0.3; // of the radius: so far motion may carry a shadow out of the box
const WING = 0.045; // of the arrow, in its size
const ARROW_SHARE = 0.95; // of what is seen beside the tree

export class Surroundings {
  constructor(scene) {
    this.sky = new THREE.HemisphereLight();
    this.sky.position.set(0, 0, 1);
    this.sun = new THREE.DirectionalLight();
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.setScalar(2048);
    this.sun.shadow.radius = 3;
    this.sun.shadow.camera.up.set(0, 0, 1);
    this.ground = new Ground();
    this.arrow = windArrow();
    this.backdrop = new Sky();
    this.sunPlace = SUN;
    scene.add(this.sky, this.sun, this.sun.target, this.ground, this.arrow, this.backdrop);
  }

  /** Colours of the theme: "light" or "dark". */
  look(name) {
    const look = LOOKS[name];
    this.sky.color.set(look.sky);
    this.sky.groundColor.set(look.earth);
    this.sky.intensity = look.ambient;
    this.sun.color.set(look.sun);
    this.sun.intensity = look.strength;
    this.ground.look(look);
  }

  /** Where the sun is seen from the tree: the direction over the ground, and the height above it [degrees both]. */
  set sunPlace(place) {
    this._sunPlace = place;
    const [from, height] = [place.from_deg, place.height_deg].map(THREE.MathUtils.degToRad);
    const level = Math.cos(height);
    this.sunward = new THREE.Vector3(level * Math.cos(from), level * Math.sin(from), Math.sin(height));
    this.sun.position.copy(this.sun.target.position).addScaledVector(this.sunward, 4 * (this.radius ?? 1));
    if (this.radius) this._fitShadow();
  }

  /** The sun sees the box as closely as motion allows: its map has no texels, and the ground no lookups, for what is beside. */
  _fitShadow() {
    const { radius, half, sunward } = this;
    const right = new THREE.Vector3(0, 0, 1).cross(sunward).normalize();
    const up = new THREE.Vector3().crossVectors(sunward, right);
    const [x, y] = [right, up].map((axis) => AROUND * radius + half.dot(positive(axis)));
    const box = { left: -x, right: x, top: y, bottom: -y, near: radius, far: 8 * radius };
    Object.assign(this.sun.shadow.camera, box).updateProjectionMatrix();
  }

  get sunPlace() {
    return this._sunPlace;
  }

  /** Place everything under a box of this middle, half sizes, radius and lowest z. */
  frame(middle, half, radius, bottom) {
    this.ground.position.set(middle.x, middle.y, bottom - 0.002 * radius);
    this.ground.scale.setScalar(radius * 2.3);
    this.arrow.position.set(middle.x, middle.y, bottom);
    this.radius = radius;
    this.half = half;
    this.sun.target.position.copy(middle);
    this.sunPlace = this.sunPlace;
    this.sun.shadow.normalBias = radius * SLACK;
    this.sun.shadow.bias = -0.0008;
  }

  /** Draw the arrow so near that it stays in the view, of which `half` is seen on either side [m]. */
  bringArrowNear(half) {
    this.arrow.scale.setScalar(Math.min(this.radius, ARROW_SHARE * half));
  }

  wind(direction_deg, strength, colour) {
    this.arrow.rotation.z = THREE.MathUtils.degToRad(direction_deg);
    this.arrow.visible = strength > 0;
    this.arrow.material.color.set(colour);
    this.arrow.material.opacity = 0.35 + 0.5 * Math.min(strength, 1);
  }
}

const positive = ({ x, y, z }) => new THREE.Vector3(Math.abs(x), Math.abs(y), Math.abs(z));

/** Three chevrons on the ground before the tree, pointing along +X. */
function windArrow() {
  const along = [0, -1, -2, -1, -2, -1]; // of each one's corners from its tip
  const across = [0, 1, 1, 0, -1, -1];
  const chevron = (tip) => new THREE.Shape(along.map((x, i) => new THREE.Vector2(tip + WING * x, WING * across[i])));
  const geometry = new THREE.ShapeGeometry([0.84, 0.925, 1.01].map(chevron));
  const material = new THREE.MeshBasicMaterial({ transparent: true, side: THREE.DoubleSide, depthWrite: false });
  const arrow = new THREE.Mesh(geometry, material);
  arrow.visible = false;
  return arrow;
}
