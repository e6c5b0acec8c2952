// The mesh as it is drawn: geometry from a surface file, materials whose vertices follow the field and the bones.

import * as THREE from "three";
import { DISPLACE } from "./field.js";
import { readTensors } from "./modes.js";

const LEAF_VOXELS = 14; // a connected part that is smaller is taken for foliage, and shaded as a soft mass
const LEAF_FACES = 400;

/** `{ geometry, materials, ... }` of the body of …/surface. */
export async function readSurface(buffer) {
  const { tensors, shape, metadata } = readTensors(buffer);
  const surface = { ...tensors, N: shape.vertices[0], F: shape.faces[0], materials: JSON.parse(metadata.materials) };
  surface.textures = await Promise.all(surface.materials.map((_, index) => readTexture(tensors[`texture_${index}`])));
  surface.geometry = buildGeometry(surface);
  return surface;
}

async function readTexture(bytes) {
  if (!bytes) return null;
  const picture = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  const texture = new THREE.Texture(picture);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.flipY = false; // v runs downward, as in glTF
  texture.anisotropy = 4;
  texture.needsUpdate = true;
  return texture;
}

function buildGeometry(surface) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(surface.vertices, 3));
  if (surface.uv) geometry.setAttribute("uv", new THREE.BufferAttribute(surface.uv, 2));
  setBones(geometry, surface);
  const { index, groups } = byMaterial(surface);
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  for (const group of groups) geometry.addGroup(...group);
  geometry.computeVertexNormals();
  geometry.computeBoundingBox();
  softenFoliage(geometry, surface);
  return geometry;
}

function setBones(geometry, surface) {
  const still = (width) => new Uint8Array(width * surface.N);
  geometry.setAttribute("boneRows", new THREE.BufferAttribute(surface.bone_rows ?? new Uint16Array(4 * surface.N), 4));
  geometry.setAttribute("boneWeights", new THREE.BufferAttribute(surface.bone_weights ?? still(4), 4, true));
  if (!surface.tie_rows) return;
  geometry.setAttribute("tieRows", new THREE.BufferAttribute(Float32Array.from(surface.tie_rows), 4));
  geometry.setAttribute("tieWeights", new THREE.BufferAttribute(surface.tie_weights, 4, true));
}

/** Faces sorted by material: one draw each. */
function byMaterial({ faces, face_material: of, F, materials }) {
  if (!of || materials.length < 2) return { index: new Uint32Array(faces), groups: [[0, 3 * F, 0]] };
  const start = new Uint32Array(materials.length + 1);
  for (let f = 0; f < F; f++) start[of[f] + 1]++;
  for (let m = 0; m < materials.length; m++) start[m + 1] += start[m];
  const index = new Uint32Array(3 * F);
  const next = start.slice();
  for (let f = 0; f < F; f++) index.set(faces.subarray(3 * f, 3 * f + 3), 3 * next[of[f]]++);
  return {
    index,
    groups: materials.map((_, m) => [3 * start[m], 3 * (start[m + 1] - start[m]), m]).filter(([, count]) => count),
  };
}

/** Small parts get normals that look out of the crown, a little variation, and shade towards its heart. */
function softenFoliage(geometry, surface) {
  const { min, max } = geometry.boundingBox;
  const part = partsOf(surface.faces, surface.N);
  const size = new Map(); // of each part: faces, and its box
  const x = surface.vertices;
  const normal = geometry.attributes.normal;
  for (let v = 0; v < surface.N; v++) {
    const box =
      size.get(part[v]) ??
      size.set(part[v], [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity, 0]).get(part[v]);
    for (let c = 0; c < 3; c++) {
      box[c] = Math.min(box[c], x[3 * v + c]);
      box[3 + c] = Math.max(box[3 + c], x[3 * v + c]);
    }
    box[6]++;
  }
  const limit = (LEAF_VOXELS * Math.max(max.x - min.x, max.y - min.y, max.z - min.z)) / 128;
  const isLeaf = (box) => box[6] < LEAF_FACES && Math.max(box[3] - box[0], box[4] - box[1], box[5] - box[2]) < limit;
  const crown = new THREE.Box3();
  for (const box of size.values())
    if (isLeaf(box))
      crown.union(new THREE.Box3(new THREE.Vector3(...box.slice(0, 3)), new THREE.Vector3(...box.slice(3, 6))));
  const heart = crown.getCenter(new THREE.Vector3());
  const half = crown
    .getSize(new THREE.Vector3())
    .multiplyScalar(0.5)
    .max(new THREE.Vector3(1e-6, 1e-6, 1e-6));
  const shade = new Uint8Array(3 * surface.N).fill(255);
  const given = surface.vertex_colors;
  const own = new THREE.Vector3();
  const out = new THREE.Vector3();
  for (let v = 0; v < surface.N; v++) {
    let light = 1;
    if (isLeaf(size.get(part[v]))) {
      out
        .set(x[3 * v], x[3 * v + 1], x[3 * v + 2])
        .sub(heart)
        .divide(half);
      light = (0.62 + 0.38 * THREE.MathUtils.smoothstep(out.length(), 0.15, 0.95)) * (0.86 + 0.28 * hash(part[v]));
      out.divide(half).normalize();
      own.fromBufferAttribute(normal, v);
      if (own.dot(out) < 0) own.negate();
      own.multiplyScalar(0.45).addScaledVector(out, 0.75).normalize();
      normal.setXYZ(v, own.x, own.y, own.z);
    }
    for (let c = 0; c < 3; c++) {
      const base = given ? 255 * linear(given[4 * v + c] / 255) : 220;
      shade[3 * v + c] = Math.min(255, base * light);
    }
  }
  geometry.setAttribute("color", new THREE.BufferAttribute(shade, 3, true));
}

const linear = (s) => (s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4);
const hash = (n) => {
  const s = Math.sin(n * 12.9898) * 43758.5453;
  return s - Math.floor(s);
};

/** Which vertices hang together: union-find over the faces. */
function partsOf(faces, N) {
  const parent = Uint32Array.from({ length: N }, (_, v) => v);
  const root = (v) => {
    while (parent[v] !== v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (let f = 0; f < faces.length; f += 3) {
    const a = root(faces[f]);
    parent[root(faces[f + 1])] = a;
    parent[root(faces[f + 2])] = a;
  }
  return parent.map((_, v) => root(v));
}

// ---- materials

const FOLLOW = (tied) => /* glsl */ `
attribute vec4 boneRows; attribute vec4 boneWeights;
${tied ? "attribute vec4 tieRows; attribute vec4 tieWeights;" : ""}
varying float vShare;
mat4 poseHere;
vec3 follow(vec3 rest) {
  vec4 m = ${
    tied
      ? "vec4(0.0); for (int i = 0; i < 4; i++) m += tieWeights[i] * movedAt(int(tieRows[i]))"
      : "movedAt(gl_VertexID)"
  };
  vShare = m.w;
  vec3 x = rest + m.xyz;
  poseHere = mat4(1.0);
  if (bent > 0.5) {
    poseHere = mat4(0.0);
    for (int i = 0; i < 4; i++) poseHere += boneWeights[i] * poseOf(int(boneRows[i] + 0.5));
    x = (poseHere * vec4(x, 1.0)).xyz;
  }
  return x;
}`;

// a map that reads as one: dark where nothing moves, through the accent's blue and green to a light yellow
const RAMP = /* glsl */ `
vec3 ramp(float s) {
  s = clamp(s, 0.0, 1.0);
  vec3 a = vec3(0.10, 0.11, 0.24), b = vec3(0.08, 0.38, 0.55), c = vec3(0.22, 0.66, 0.47), d = vec3(0.99, 0.88, 0.30);
  return s < 0.33 ? mix(a, b, s / 0.33) : s < 0.66 ? mix(b, c, (s - 0.33) / 0.33) : mix(c, d, (s - 0.66) / 0.34);
}`;

/** Make a material's vertices follow; `shared` are the tree's uniforms. */
export function makeFollow(material, shared, { tied = false } = {}) {
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, shared);
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", `#include <common>\n${DISPLACE}\n${FOLLOW(tied)}`)
      .replace(
        "#include <beginnormal_vertex>",
        "vec3 followed = follow(position);\n#include <beginnormal_vertex>\nobjectNormal = mat3(poseHere) * objectNormal;",
      )
      .replace(
        "#include <begin_vertex>",
        `vec3 transformed = ${material.isMeshLambertMaterial ? "followed" : "follow(position)"};`,
      );
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", `#include <common>\nuniform float coloured; varying float vShare;\n${RAMP}`)
      .replace(
        "#include <color_fragment>",
        "#include <color_fragment>\nif (coloured > 0.5) diffuseColor.rgb = ramp(vShare);",
      )
      // normals of foliage look outward on both sides
      .replace(
        "#include <normal_fragment_begin>",
        "float faceDirection = 1.0; vec3 normal = normalize(vNormal); vec3 nonPerturbedNormal = normal;",
      );
  };
  material.customProgramCacheKey = () => `follow-${material.type}-${tied}`;
  return material;
}

export function surfaceMaterials(surface, shared, { tied }) {
  const all = surface.materials.length ? surface.materials : [{ base_color: [0.5, 0.5, 0.5, 1], alpha_cutoff: null }];
  return all.map(({ base_color: [r, g, b], alpha_cutoff: cut }, index) =>
    makeFollow(
      new THREE.MeshLambertMaterial({
        color: new THREE.Color(r, g, b),
        map: surface.textures[index] ?? null,
        vertexColors: true,
        alphaTest: cut ?? 0,
        side: THREE.DoubleSide,
        shadowSide: THREE.DoubleSide,
      }),
      shared,
      { tied },
    ),
  );
}

/** What the sun sees: the same motion, cut out where the surface is. */
export function shadowMaterial(surface, shared, { tied }) {
  const cut = surface.materials.findIndex(
    (material, index) => material.alpha_cutoff !== null && surface.textures[index],
  );
  return makeFollow(
    new THREE.MeshDepthMaterial({
      side: THREE.DoubleSide,
      map: cut < 0 ? null : surface.textures[cut],
      alphaTest: cut < 0 ? 0 : surface.materials[cut].alpha_cutoff,
    }),
    shared,
    { tied },
  );
}
