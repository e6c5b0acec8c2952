// Foliage is shaded as a soft mass: its normals look out of the crown, and it is darker towards the middle.

import * as THREE from "three";

const LEAF_VOXELS = 14; // a connected part that is smaller is taken for foliage
const LEAF_FACES = 400;

/** Change the normals of small parts, and set the vertex colours of all. */
export function softenFoliage(geometry, surface) {
  const { N, vertices, vertex_colors: colours } = surface;
  const part = partsByPlace(vertices, surface.faces, N);
  const boxes = boxesOf(part, vertices, N);
  const isLeaf = leafTest(surface.box);
  const crown = new THREE.Box3();
  for (const { box, count } of boxes.values()) if (isLeaf(box, count)) crown.union(box);
  const middle = crown.getCenter(new THREE.Vector3());
  const half = crown.getSize(new THREE.Vector3()).multiplyScalar(0.5);
  half.max(new THREE.Vector3(1e-6, 1e-6, 1e-6));
  const shade = new Uint8Array(3 * N).fill(255);
  const { normal } = geometry.attributes;
  const own = new THREE.Vector3();
  const out = new THREE.Vector3();
  for (let v = 0; v < N; v++) {
    let light = 1;
    const { box, count } = boxes.get(part[v]);
    if (isLeaf(box, count)) {
      out.fromArray(vertices, 3 * v).sub(middle);
      out.divide(half);
      light = (0.62 + 0.38 * THREE.MathUtils.smoothstep(out.length(), 0.15, 0.95)) * (0.86 + 0.28 * hash(part[v]));
      out.divide(half).normalize();
      own.fromBufferAttribute(normal, v);
      if (own.dot(out) < 0) own.negate();
      own.multiplyScalar(0.45).addScaledVector(out, 0.75).normalize();
      normal.setXYZ(v, own.x, own.y, own.z);
    }
    for (let c = 0; c < 3; c++) {
      const base = colours ? 255 * linear(colours[4 * v + c] / 255) : 220;
      shade[3 * v + c] = Math.min(255, base * light);
    }
  }
  geometry.setAttribute("color", new THREE.BufferAttribute(shade, 3, true));
}

function leafTest({ min, max }) {
  const limit = (LEAF_VOXELS * Math.max(max.x - min.x, max.y - min.y, max.z - min.z)) / 128;
  const size = new THREE.Vector3();
  return (box, count) => {
    box.getSize(size);
    return count < LEAF_FACES && Math.max(size.x, size.y, size.z) < limit;
  };
}

/** The bounding box and the number of vertices of each part. */
function boxesOf(part, vertices, N) {
  const boxes = new Map();
  const at = new THREE.Vector3();
  for (let v = 0; v < N; v++) {
    let entry = boxes.get(part[v]);
    if (!entry) boxes.set(part[v], (entry = { box: new THREE.Box3(), count: 0 }));
    entry.box.expandByPoint(at.fromArray(vertices, 3 * v));
    entry.count++;
  }
  return boxes;
}

/** The connected part of each vertex, where vertices in one place are one: a file may have one for each corner of a face. */
export function partsByPlace(vertices, faces, N) {
  const first = new Map();
  const same = Uint32Array.from({ length: N }, (_, v) => {
    const place = vertices[3 * v] + Math.SQRT2 * vertices[3 * v + 1] + Math.sqrt(3) * vertices[3 * v + 2]; // a fast key
    if (!first.has(place)) first.set(place, v);
    return first.get(place);
  });
  const parts = connectedParts(faces ? Array.from(faces, (v) => same[v]) : same, N);
  return parts.map((_, v) => parts[same[v]]);
}

/** The connected part of each vertex: union-find over the faces. */
function connectedParts(faces, N) {
  const parent = Uint32Array.from({ length: N }, (_, v) => v);
  const root = (v) => {
    let at = v;
    while (parent[at] !== at) at = parent[at] = parent[parent[at]];
    return at;
  };
  for (let f = 0; f < faces.length; f += 3) {
    const first = root(faces[f]);
    parent[root(faces[f + 1])] = first;
    parent[root(faces[f + 2])] = first;
  }
  return parent.map((_, v) => root(v));
}

const linear = (s) => (s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4);
const hash = (n) => {
  const s = Math.sin(n * 12.9898) * 43758.5453;
  return s - Math.floor(s);
};
