// A tree on the stage: its surface at rest as soon as there is one, in motion as soon as there are modes.

import * as THREE from "three";
import { verticesNear } from "../motion/hang.js";
import { carried } from "../motion/modes.js";
import { binSizes, displaced } from "../motion/swing.js";
import { plus, rowOf } from "../motion/vectors.js";
import { Copies } from "./copies.js";
import { buildCubes, disposeCubes } from "./cubes.js";
import { Field, floats, texture } from "./field.js";
import { ghostOf, surfaceMaterials, uniformsAt } from "./follow.js";
import { LEAST } from "./resolution.js";
import { carryByJoints, nearBox } from "./surface.js";

export class Tree {
  constructor(stage) {
    Object.assign(this, { stage, group: new THREE.Group() });
    stage.scene.add(this.group);
    this.still = texture(floats(0)); // zero, until there are modes
    this.ofVoxels = null; // once they are asked for
    this.uniforms = uniformsAt(this.still);
    this.groups = []; // of pulls: { seed, bend }
    Object.assign(this, { view: "surface", q: null, turn: 0, air: null });
  }

  get moves() {
    return Boolean(this.modes);
  }

  /** How the bones swing now, see `swingBones`. */
  get swings() {
    return this.field.ofCopy[0];
  }

  /** The vertex that each voxel moves with. */
  get vertexOf() {
    return (this.ofVoxels ??= verticesNear(this.modes, this.surface.vertices));
  }

  // ---- what it consists of

  /** The mesh; `hidden` where a cloud is drawn in its place and the mesh only casts the shadow. */
  setSurface(surface, { hidden = false } = {}) {
    this._dropMesh();
    Object.assign(this, { surface, hidden });
    const fast = { anisotropy: 1, minFilter: THREE.LinearMipmapNearestFilter }; // in software each lookup counts
    if (this.stage.soft) for (const texture of surface.textures) Object.assign(texture ?? {}, fast);
    this.mesh = new THREE.Mesh(surface.geometry);
    this.mesh.castShadow = this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    this.ghost = ghostOf(surface.geometry);
    this.group.add(this.mesh, this.ghost);
    this._setMaterials();
    this._frame();
    this.stage.stale = true;
  }

  /** The camera on what is seen: a cloud has still parts, such as a pot, that its mesh does not have. */
  _frame() {
    const { surface, box } = this;
    const cloud = this.points ?? this.splat;
    this.box = surface && cloud ? nearBox(surface.box, cloud.box) : (surface ?? cloud).box;
    if (!box || box.max.distanceTo(this.box.max) > 1e-4) this.stage.frame(this.box);
  }

  _setMaterials() {
    for (const material of [this.mesh.material, this.mesh.customDepthMaterial].flat()) material?.dispose();
    const { lit, depth } = surfaceMaterials(this.surface, this.uniforms);
    this.mesh.material = lit;
    this.mesh.customDepthMaterial = depth;
    if (this.copies) this.setCopies(this.copies.places);
    this.setView(this.view);
  }

  setModes(modes) {
    this.modes = modes;
    this.poses = texture(floats(12 * modes.J));
    this.uniforms.poses.value = this.poses;
    this.uniforms.castPoses.value = texture(floats(12 * modes.J));
    carryByJoints(this.surface, modes);
    this.field = new Field(this.surface);
    this.uniforms.moved.value = this.field.texture;
  }

  /** The points of a cloud at rest, until its Gaussians move. */
  setPoints(points) {
    this.points = points;
    this.group.add(points.object);
    this._frame();
    this.setView(this.view);
  }

  /** The mesh in place of points. */
  showMesh() {
    if (this.points) this.group.remove(this.points.object);
    this.points?.dispose();
    this.points = null;
    this.hidden = false;
    this.setView(this.view);
  }

  /** Gaussians in place of the mesh, which carries them and goes on casting the shadow. */
  async setSplat(splat) {
    const { SplatView } = await import("./splat.js");
    const view = await SplatView.make(this.stage, splat, this.surface, this.uniforms);
    if (this.disposed) return view.dispose();
    Object.assign(this.stage.resolution, { stillScale: 1, least: LEAST }); // Gaussians have soft edges, and cost by pixels
    this.splat = view;
    this._frame();
    this.setView(this.view);
  }

  /** The tree again at these places, each moved by `copies.move`; none for an empty list. */
  setCopies(places) {
    const moved = JSON.stringify(places) !== JSON.stringify(this.copies?.places ?? []);
    this.copies?.dispose();
    this.copies = null;
    if (places.length && this.field && !this.hidden) {
      this.copies = new Copies(this, places);
      this.group.add(this.copies.mesh);
    }
    if (moved) this.stage.frame(this.copies ? this.copies.box.union(this.box) : this.box);
    this.setView(this.view);
  }

  // ---- how it is drawn

  /** surface, wire, voxels or modes. */
  setView(view) {
    this.view = view;
    const cubes = view === "voxels" && this.moves;
    if (this.splat) this.splat.visible = view === "surface";
    if (cubes && !this.cubes) {
      this.cubes = buildCubes(this);
      this.group.add(this.cubes);
    }
    if (this.cubes) this.cubes.visible = cubes;
    if (this.mesh) {
      this.mesh.visible = !cubes;
      for (const material of [this.mesh.material].flat()) Object.assign(material, { wireframe: view === "wire" });
    }
    if (this.copies) this.copies.mesh.visible = view === "surface";
    this._showOne();
    this.uniforms.coloured.value = view === "modes" ? 1 : 0;
    this.stage.stale = true;
  }

  /** Of mesh, points and Gaussians one is seen; points until the Gaussians are sorted. */
  _showOne() {
    const gaussians = this.splat?.visible && this.splat.drawn;
    const cloud = this.points && this.view === "surface";
    if (this.points) this.points.object.visible = cloud && !gaussians;
    const seen = !gaussians && !cloud && !(this.hidden && this.view === "surface");
    for (const material of [this.mesh?.material ?? []].flat()) material.colorWrite = material.depthWrite = seen;
  }

  /** Colour how far bin k moves each place; returns the furthest [m]. */
  showBin(k) {
    const { surface } = this;
    const all = surface.turn_bone.map((_, v) => v);
    const sizes = binSizes(surface, k, all);
    const largest = sizes.reduce((most, size) => Math.max(most, size), 1e-12);
    const { share } = surface.geometry.attributes;
    share.array.set(sizes.map((size) => size / largest));
    share.needsUpdate = true;
    this.stage.stale = true;
    return largest;
  }

  // ---- motion

  /** Take a motion: see `swingBones`. */
  swing(motion) {
    Object.assign(this, motion);
    this.field.swing([motion]);
  }

  /** Take groups of pushes, under the wind that it swings in. */
  bend(groups) {
    this.groups = groups;
    this.uniforms.bent.value = groups.length ? 1 : 0;
    if (groups.length) {
      this.jointMotion = this.modes.poses(groups, this.poses.image.data);
      this.poses.needsUpdate = true;
    }
    this.stage.stale = true;
  }

  /** A gust over the wind: see Gust.after. */
  blow(gust) {
    this.field.blow(gust);
  }

  /** Before each draw. */
  prepare(renderer) {
    if (this.splat) this._showOne();
    if (!this.q) return;
    this.field.render(renderer, this.uniforms);
    if (renderer.shadowMap.needsUpdate) this._castPoses();
    this.copies?.prepare(renderer);
    if (this.splat?.visible) this.splat.evaluate(this.q, this.turn, this.air);
  }

  /** Poses of the shadow map that is drawn now. */
  _castPoses() {
    const { bent, castBent, castPoses } = this.uniforms;
    castBent.value = bent.value;
    if (!bent.value) return;
    castPoses.value.image.data.set(this.poses.image.data);
    castPoses.value.needsUpdate = true;
  }

  /** Where a voxel is now [m]. */
  voxelNow(v) {
    const at = plus(rowOf(this.modes.centres, v), displaced(this.surface, this.vertexOf[v], this.swings));
    return this.groups.length ? carried(this.jointMotion, this.modes.joint_of_voxel[v], at) : at;
  }

  // ---- the end

  _dropMesh() {
    if (!this.mesh) return;
    this.group.remove(this.mesh, this.ghost);
    this.mesh.geometry.dispose();
    const materials = [this.mesh.material, this.mesh.customDepthMaterial, this.ghost.material].flat();
    for (const resource of [...materials, ...this.surface.textures]) resource?.dispose();
    this.mesh = this.ghost = null;
  }

  dispose() {
    this.disposed = true;
    this.copies?.dispose();
    this._dropMesh();
    this.splat?.dispose();
    this.points?.dispose();
    if (this.cubes) disposeCubes(this.cubes);
    for (const resource of [this.field, this.poses, this.uniforms.castPoses.value, this.still]) resource?.dispose();
    this.stage.scene.remove(this.group);
    this.stage.stale = true;
  }
}
