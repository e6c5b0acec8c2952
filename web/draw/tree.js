// A tree on the stage: its surface at rest as soon as there is one, in motion as soon as there are modes.

import * as THREE from "three";
import { hang } from "../motion/hang.js";
import { carried, largestSwing } from "../motion/modes.js";
import { fieldOf } from "./bone_field.js";
import { Copies } from "./copies.js";
import { buildCubes, disposeCubes } from "./cubes.js";
import { PoseTexture, voxelFieldOf, zeroTexture } from "./field.js";
import { ghostOf, surfaceMaterials } from "./follow.js";
import { LEAST } from "./resolution.js";
import { leavesItsShadow } from "./shadow.js";
import { nearBox } from "./surface.js";

export class Tree {
  constructor(stage) {
    Object.assign(this, { stage, group: new THREE.Group() });
    stage.scene.add(this.group);
    this.still = zeroTexture();
    this.uniforms = {
      moved: { value: this.still },
      poses: { value: this.still },
      bent: { value: 0 },
      coloured: { value: 0 },
      restAt: { value: this.still }, // a sampler without a texture spoils every draw
    };
    this.groups = []; // of pushes: { q, perBone }
    Object.assign(this, { view: "surface", q: null, turn: 0 });
  }

  get moves() {
    return Boolean(this.modes);
  }

  get usesNearVoxels() {
    return Boolean(this.surface?.tie_rows);
  }

  // ---- what it consists of

  /** The mesh; `hidden` where a cloud is drawn in its place and the mesh only casts the shadow. */
  setSurface(surface, { hidden = false } = {}) {
    this._dropMesh();
    Object.assign(this, { surface, hidden });
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
    if (this.copies) this.setCopies(this.copies.places, this.copies.other);
    this.setView(this.view);
  }

  setModes(modes) {
    this.modes = modes;
    const { surface } = this;
    if (!modes.shapes) hang(modes, surface);
    this.poses = new PoseTexture(modes.B);
    this.uniforms.poses.value = this.poses.texture;
    if (surface?.shapes || surface?.turn_parent) this.field = fieldOf(surface, modes);
    if (this.usesNearVoxels) this.field = this._voxelField();
    if (this.field) this.uniforms.moved.value = this.field.texture;
    this.largest = largestSwing(surface?.shapes ? surface : modes);
  }

  /** A large mesh's own motion in place of its nearest voxels', once the job's files contain it. */
  setShapes(shapes) {
    Object.assign(this.surface, shapes, { tie_rows: null });
    this.field = fieldOf(this.surface);
    this.uniforms.moved.value = this.field.texture;
    this.largest = largestSwing(this.surface);
    this._setMaterials();
  }

  /** Metal, roughness and maps of the materials, one a material or null, once a file says more than colours. */
  setLooks(looks) {
    this.surface.looks = looks;
    const maps = looks.flatMap((look) => (look ? [look.normalMap, look.roughnessMap] : []));
    this.surface.textures.push(...maps); // behind the colours, to be disposed of with them
    this.stage.surroundings.reflect(this.stage.renderer);
    this._setMaterials();
  }

  _voxelField() {
    return (this.voxelField ??= voxelFieldOf(this.modes));
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
    const [{ SplatView }, { rideOf }] = await Promise.all([import("./splat.js"), import("./ride.js")]);
    const view = await SplatView.make(this.stage, splat, rideOf(splat, this), this.uniforms);
    if (this.disposed) return view.dispose();
    Object.assign(this.stage.resolution, { stillScale: 1, least: LEAST }); // Gaussians have soft edges, and cost by pixels
    this.splat = view;
    this._frame();
    this.setView(this.view);
  }

  /**
   * The tree again at these places, each moved by `copies.move`; none for an empty list. `field` is that of another
   * motion of the same tree, where the copies have one.
   */
  setCopies(places, field = null) {
    const moved = JSON.stringify(places) !== JSON.stringify(this.copies?.places ?? []);
    this.copies?.dispose();
    this.copies = null;
    if (places.length && this.field && !this.hidden) {
      this.copies = new Copies(this, places, field);
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
      this.cubes = buildCubes(this.modes, { ...this.uniforms, moved: { value: this._voxelField().texture } });
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

  /** Colour the share that a bin has in the motion of each place; null for none. */
  setShown(k) {
    this.field?.show(k, k === null ? 1 : this.largest[k]);
    this.stage.stale = true;
  }

  // ---- motion

  /** The wind's coordinates [2K] turned by `turn` [rad], and groups of pushes. */
  move(q, turn, groups) {
    Object.assign(this, { q, turn, groups });
    this.uniforms.bent.value = groups.length ? 1 : 0;
    if (groups.length) {
      this.boneMotion ??= new Float32Array(12 * this.modes.B);
      this.poses.set(this.modes.poses(groups, this.boneMotion));
    }
    Object.assign(this.stage, { stale: true, swift: groups.length > 0 || this.blown || leavesItsShadow(this) });
  }

  /** A gust over the wind: see Gust.after. */
  blow(gust) {
    this.blown = Boolean(gust);
    for (const field of [this.field, this.voxelField, this.splat?.field]) field?.blow(gust);
  }

  /** Before each draw. */
  prepare(renderer) {
    if (this.splat) this._showOne();
    if (!this.q) return;
    if (renderer.shadowMap.needsUpdate) this.shadowed = { q: this.q.slice(), turn: this.turn };
    const cubes = this.cubes?.visible;
    if (this.field && (this.field !== this.voxelField || !cubes)) this.field.evaluate(renderer, this.q, this.turn);
    this.copies?.prepare(renderer);
    if (cubes) this.voxelField.evaluate(renderer, this.q, this.turn);
    if (this.splat?.visible) this.splat.evaluate(renderer, this.q, this.turn);
  }

  /** Where a voxel is now [m]. */
  voxelNow(v) {
    const at = this.modes.voxelInWind(v, this.q, this.turn);
    return this.groups.length ? carried(this.boneMotion, this.modes.bone_of_voxel[v], at) : at;
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
    for (const resource of new Set([this.field, this.voxelField, this.poses, this.still])) resource?.dispose();
    this.stage.scene.remove(this.group);
    Object.assign(this.stage, { stale: true, swift: false });
  }
}
