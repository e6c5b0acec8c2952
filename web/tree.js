// A tree on the stage: its surface at rest as soon as there is one, in motion as soon as there are modes.

import * as THREE from "three";
import { Field, PoseTexture } from "./field.js";
import { carried } from "./modes.js";
import { makeFollow, shadowMaterial, surfaceMaterials } from "./surface.js";

const PICK_PX = 16; // a finger is not sharper

export class Tree {
  constructor(stage) {
    this.stage = stage;
    this.group = new THREE.Group();
    stage.scene.add(this.group);
    this.uniforms = { moved: { value: null }, poses: { value: null }, bent: { value: 0 }, coloured: { value: 0 } };
    this.view = "surface";
    this.groups = []; // of pushes: { q, perBone }
    this.q = null;
    this.turn = 0;
  }

  /** The mesh, at rest or tied to modes. */
  setSurface(surface) {
    const { min, max } = surface.geometry.boundingBox;
    const same = this.surface && Math.abs(this.surface.geometry.boundingBox.max.z - max.z) < 1e-4;
    this._dropMesh();
    this.surface = surface;
    const tied = Boolean(surface.tie_rows);
    this.mesh = new THREE.Mesh(surface.geometry, surfaceMaterials(surface, this.uniforms, { tied }));
    if (this.mesh.material.length === 1) this.mesh.material = this.mesh.material[0];
    this.mesh.castShadow = this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    this.mesh.customDepthMaterial = shadowMaterial(surface, this.uniforms, { tied });
    const ghost = new THREE.MeshBasicMaterial({
      transparent: true,
      opacity: 0.22,
      depthWrite: false,
      side: THREE.DoubleSide,
    });
    this.ghost = new THREE.Mesh(surface.geometry, ghost);
    this.ghost.visible = false;
    this.group.add(this.mesh, this.ghost);
    this._setStill();
    if (!same) this.stage.frame({ min, max });
    this.stage.stale = true;
  }

  /** Zero displacement until there are modes. */
  _setStill() {
    this.still = new THREE.DataTexture(new Float32Array(4), 1, 1, THREE.RGBAFormat, THREE.FloatType);
    this.still.needsUpdate = true;
    this.uniforms.moved.value = this.still;
    this.uniforms.poses.value = this.still;
  }

  setModes(modes) {
    this.modes = modes;
    const { surface } = this;
    this.poses = new PoseTexture(modes.B);
    this.uniforms.poses.value = this.poses.texture;
    if (surface?.shapes) this.field = new Field(surface.shapes, surface.scale_m, surface.N);
    if (surface?.tie_rows) this.field = this._voxelField();
    if (this.field) this.uniforms.moved.value = this.field.texture;
    this.largest = largestSwing(surface?.shapes ? surface : modes);
  }

  /** In place of near voxels: a large mesh's own motion, once the job's files tell it. */
  setShapes({ shapes, scale_m }) {
    const { surface } = this;
    Object.assign(surface, { shapes, scale_m, tie_rows: null });
    for (const material of [this.mesh.material, this.mesh.customDepthMaterial].flat()) material.dispose();
    const all = surfaceMaterials(surface, this.uniforms, { tied: false });
    this.mesh.material = all.length === 1 ? all[0] : all;
    this.mesh.customDepthMaterial = shadowMaterial(surface, this.uniforms, { tied: false });
    this.field = new Field(shapes, scale_m, surface.N);
    this.uniforms.moved.value = this.field.texture;
    this.largest = largestSwing(surface);
    this.setView(this.view);
  }

  get hangsOnVoxels() {
    return Boolean(this.surface?.tie_rows);
  }
  get moves() {
    return Boolean(this.modes);
  }
  _voxelField() {
    return (this.voxelField ??= new Field(this.modes.shapes, this.modes.scale_m, this.modes.V));
  }

  /** Gaussians in place of the mesh, which carries them and goes on casting the shadow. */
  async setSplat(splat) {
    const { SplatView, carriersOf } = await import("./splat.js");
    const made = await SplatView.make(this.stage, splat, carriersOf(splat, this.surface, this.modes), this.uniforms);
    if (this.gone) return made.dispose();
    this.splat = made;
    this.setView(this.view);
  }

  /** surface, wire, voxels or modes. */
  setView(view) {
    this.view = view;
    const cubes = view === "voxels";
    if (this.splat) this.splat.visible = view === "surface";
    if (cubes && !this.cubes) this._buildCubes();
    if (this.cubes) this.cubes.visible = cubes;
    if (this.mesh) {
      this.mesh.visible = !cubes;
      for (const material of [this.mesh.material].flat()) material.wireframe = view === "wire";
    }
    this._giveWay();
    this.uniforms.coloured.value = view === "modes" ? 1 : 0;
    this.stage.stale = true;
  }

  /** The mesh is seen until its Gaussians are. */
  _giveWay() {
    const seen = !(this.splat?.visible && this.splat.drawn);
    for (const material of [this.mesh?.material ?? []].flat()) material.colorWrite = material.depthWrite = seen;
  }

  /** Colour the share that a bin has in the motion of each place; null for none. */
  setShown(k) {
    this.field?.show(k, k === null ? 1 : this.largest[k]);
    this.stage.stale = true;
  }

  setGhost(shown, colour) {
    this.ghost.visible = shown;
    this.ghost.material.color.set(colour);
    this.stage.stale = true;
  }

  /** The wind's coordinates [2K] turned by `turn`, and groups of pushes. */
  move(q, turn, groups) {
    Object.assign(this, { q, turn, groups });
    this.uniforms.bent.value = groups.length ? 1 : 0;
    if (groups.length) this.poses.set(this.modes.poses(groups, (this._poses ??= new Float32Array(12 * this.modes.B))));
    this.stage.stale = true;
  }

  /** Before each draw. */
  prepare(renderer) {
    if (this.splat) this._giveWay();
    if (!this.q) return;
    if (this.field && (this.field !== this.voxelField || !this.cubes?.visible))
      this.field.evaluate(renderer, this.q, this.turn);
    if (this.cubes?.visible) this.voxelField.evaluate(renderer, this.q, this.turn);
    if (this.splat?.visible) this.splat.evaluate(renderer, this.q, this.turn);
  }

  _buildCubes() {
    const { modes } = this;
    const field = this._voxelField();
    const cube = new THREE.BoxGeometry(modes.voxelSize, modes.voxelSize, modes.voxelSize).toNonIndexed();
    const geometry = new THREE.InstancedBufferGeometry();
    for (const name of ["position", "normal"]) geometry.setAttribute(name, cube.attributes[name]);
    geometry.instanceCount = modes.V;
    geometry.setAttribute("centre", new THREE.InstancedBufferAttribute(modes.centres, 3));
    geometry.setAttribute("bone", new THREE.InstancedBufferAttribute(Float32Array.from(modes.bone_of_voxel), 1));
    const uniforms = { ...this.uniforms, moved: { value: field.texture } };
    this.cubes = new THREE.Mesh(geometry, cubeMaterial(uniforms));
    this.cubes.customDepthMaterial = cubeMaterial(uniforms, new THREE.MeshDepthMaterial());
    this.cubes.castShadow = this.cubes.receiveShadow = true;
    this.cubes.frustumCulled = false;
    this.group.add(this.cubes);
  }

  /** Where a voxel is now [m]. */
  voxelNow(v, q = this.q) {
    const { modes } = this;
    const [x, y, z] = modes.voxelAt(v, q);
    const [c, s] = [Math.cos(this.turn), Math.sin(this.turn)];
    const at = [
      modes.centres[3 * v] + c * x - s * y,
      modes.centres[3 * v + 1] + s * x + c * y,
      modes.centres[3 * v + 2] + z,
    ];
    return this.groups.length ? carried(this._poses, modes.bone_of_voxel[v], at) : at;
  }

  /** The voxel under the pointer, or null: the foremost of those near it on the screen. */
  pick(event, { exact = true } = {}) {
    if (!this.modes) return null;
    const { modes, stage } = this;
    const camera = stage.camera;
    const box = stage.canvas.getBoundingClientRect();
    camera.updateMatrixWorld();
    const view = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
    const [px, py] = [event.clientX - box.left, event.clientY - box.top];
    const focal = (box.height / 2) * camera.projectionMatrix.elements[5];
    let best = null;
    for (let v = 0; v < modes.V; v++) {
      const x = modes.centres[3 * v];
      const y = modes.centres[3 * v + 1];
      const z = modes.centres[3 * v + 2];
      const w = view[3] * x + view[7] * y + view[11] * z + view[15];
      if (w <= 0) continue;
      const sx = ((view[0] * x + view[4] * y + view[8] * z + view[12]) / w + 1) * 0.5 * box.width;
      const sy = (1 - (view[1] * x + view[5] * y + view[9] * z + view[13]) / w) * 0.5 * box.height;
      const slack = PICK_PX + (exact ? (focal * 0.04 * stage.height) / w : 0);
      if (Math.abs(sx - px) > slack || Math.abs(sy - py) > slack) continue;
      let [ex, ey, depth] = [sx, sy, w];
      if (exact) {
        // look again where the wind has taken it
        const now = new THREE.Vector3(...this.voxelNow(v));
        depth = camera.position.distanceTo(now);
        now.project(camera);
        [ex, ey] = [((now.x + 1) / 2) * box.width, ((1 - now.y) / 2) * box.height];
      }
      const off = Math.hypot(ex - px, ey - py);
      const size = (focal * modes.voxelSize) / w;
      if (off > Math.max(size, PICK_PX)) continue;
      const cost = depth + (Math.max(off - size, 0) / PICK_PX) * 0.2 * stage.radius;
      if (!best || cost < best.cost) best = { voxel: v, cost };
    }
    return best?.voxel;
  }

  /** The voxel that stands highest. */
  get top() {
    let best = 0;
    for (let v = 1; v < this.modes.V; v++)
      if (this.modes.centres[3 * v + 2] > this.modes.centres[3 * best + 2]) best = v;
    return best;
  }

  _dropMesh() {
    if (!this.mesh) return;
    this.group.remove(this.mesh, this.ghost);
    this.mesh.geometry.dispose();
    for (const material of [this.mesh.material, this.mesh.customDepthMaterial, this.ghost.material].flat())
      material.dispose();
    for (const texture of this.surface.textures) texture?.dispose();
    this.mesh = this.ghost = null;
  }

  dispose() {
    this.gone = true;
    this._dropMesh();
    this.splat?.dispose();
    this.cubes?.geometry.dispose();
    this.cubes?.material.dispose();
    for (const held of new Set([this.field, this.voxelField, this.poses, this.still])) held?.dispose();
    this.stage.scene.remove(this.group);
    this.stage.stale = true;
  }
}

/** The furthest that each bin swings any point [m]. */
function largestSwing({ shapes, scale_m: scale }) {
  const K = scale.length;
  const most = new Float64Array(K);
  const P = shapes.length / (6 * K);
  for (let p = 0; p < P; p++)
    for (let k = 0; k < K; k++) {
      let sum = 0;
      for (let i = 6 * (p * K + k), end = i + 6; i < end; i++) sum += shapes[i] * shapes[i];
      if (sum > most[k]) most[k] = sum;
    }
  return most.map((sum, k) => Math.sqrt(sum) * scale[k]);
}

function cubeMaterial(uniforms, material = new THREE.MeshLambertMaterial({ color: 0xffffff })) {
  makeFollow(material, uniforms);
  const follow = material.onBeforeCompile;
  material.onBeforeCompile = (shader) => {
    follow(shader);
    shader.vertexShader = shader.vertexShader
      .replace(/attribute vec4 boneRows; attribute vec4 boneWeights;/, "attribute vec3 centre; attribute float bone;")
      .replace(
        /vec3 follow\(vec3 rest\) \{[\s\S]*?\n\}/,
        `vec3 follow(vec3 corner) {
        vec4 m = movedAt(gl_InstanceID);
        vShare = m.w;
        poseHere = mat4(1.0);
        if (bent > 0.5) poseHere = poseOf(int(bone + 0.5));
        return (poseHere * vec4(centre + m.xyz, 1.0)).xyz + mat3(poseHere) * corner;
      }`,
      );
    shader.fragmentShader = shader.fragmentShader.replace(
      "#include <color_fragment>",
      "diffuseColor.rgb = mix(vec3(0.22, 0.42, 0.30), vec3(0.62, 0.74, 0.55), 0.5 + 0.5 * normalize(vNormal).y);\n#include <color_fragment>",
    );
  };
  material.customProgramCacheKey = () => `cube-${material.type}`;
  return material;
}
