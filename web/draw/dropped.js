// What was dropped, drawn from the files themselves: something to look at before the service has read them.

import * as THREE from "three";
import { softenFoliage } from "./foliage.js";
import { pointsOf, readLas, readText } from "./scan.js";
import { makeUpright } from "./upright.js";

const LARGEST_BYTES = 150e6;
/** Which way is up where nothing says so, as for the service, which looks at the shape as well. */
const UP = { glb: "+Y", gltf: "+Y", obj: "+Y", stl: "+Z", ply: "+Z", splat: "-Y", spz: "+Y", ksplat: "-Y", sog: "-Y" };
const TEXTS = ["txt", "xyz", "asc", "csv", "pts"];
const MAPS = ["map", "alphaMap", "bumpMap", "normalMap", "specularMap"];
const NOTHING = "data:,";
const HEAD_BYTES = 4096;
const SPLAT_PROPERTY = /property \w+ (f_dc_0|scale_0|packed_scale)/;
const FACES = /^element face [1-9]/m;
const UP_COMMENT = /^comment up_axis ([+-][XYZ]|[-+\d.e]+,[-+\d.e]+,[-+\d.e]+)\s*$/m;
const SPLATS = new Set(["splat", "spz", "ksplat", "sog"]);
const CLAY = 0xb9b3a4;
const load = (name) => import(`three/addons/loaders/${name}Loader.js`);

const READERS = { glb: readGltf, gltf: readGltf, obj: readObj, stl: readStl, ply: readPly, las: readLas, laz: readLas };
for (const suffix of TEXTS) READERS[suffix] = readText;
for (const suffix of [...TEXTS, "las", "laz"]) UP[suffix] = "+Z";

/**
 * `{ object, box, sizeless, dispose }` of the first of `files`, `{ name, path, content }` with paths relative to it; null for
 * what no loader here reads. A splat, whose file states no size, needs the stage, which has Spark's renderer.
 */
export async function readDropped(files, stage) {
  const [{ name, content }] = files;
  const suffix = name.split(".").pop().toLowerCase();
  if (!(suffix in UP) || content.size > LARGEST_BYTES) return null;
  const addresses = new Map();
  try {
    const head = suffix === "ply" ? await content.slice(0, HEAD_BYTES).text() : "";
    const isSplat = SPLATS.has(suffix) || SPLAT_PROPERTY.test(head);
    if (FACES.test(head) && !namedUp(head)) return null; // half of such trees lie, and stand as the service finds
    const up = namedUp(head) ?? (isSplat && suffix === "ply" ? "-Y" : UP[suffix]);
    const read = isSplat ? readSplat : READERS[suffix];
    const address = (path) => addressOf(path, files, addresses);
    const { object, box, sizeless = false, release = () => {} } = await read(files, { stage, address });
    if (!isSplat) drawAsTrees(object);
    const leave = () => {
      release();
      dispose(object);
    };
    return { ...makeUpright(object, up, box), sizeless, dispose: leave };
  } finally {
    for (const address of addresses.values()) URL.revokeObjectURL(address);
  }
}

/** The address of a companion: by its path, else by its name alone; an empty one of what was not dropped along. */
function addressOf(path, files, addresses) {
  const wanted = decodeURIComponent(path).replace(/^\.\//, "");
  const base = (of) => of.split(/[/\\]/).pop().toLowerCase();
  const file = files.find((one) => one.path === wanted) ?? files.find((one) => base(one.path) === base(wanted));
  if (!file) return NOTHING;
  if (!addresses.has(file)) addresses.set(file, URL.createObjectURL(file.content));
  return addresses.get(file);
}

async function readGltf([{ content }], { address }) {
  const { GLTFLoader } = await load("GLTF");
  const manager = new THREE.LoadingManager();
  manager.setURLModifier((url) => (/^(blob|data):/.test(url) ? url : address(url)));
  const { scene } = await new GLTFLoader(manager).parseAsync(await content.arrayBuffer(), "");
  return { object: scene };
}

async function readObj([{ content }, ...others], { address }) {
  const { OBJLoader } = await load("OBJ");
  const loader = new OBJLoader();
  const library = others.find(({ name }) => /\.mtl$/i.test(name));
  if (library) {
    const { MTLLoader } = await load("MTL");
    const manager = new THREE.LoadingManager();
    manager.setURLModifier(address);
    const done = new Promise((resolve) => Object.assign(manager, { onLoad: resolve, onError: resolve }));
    const materials = new MTLLoader(manager).parse(await library.content.text(), "");
    materials.preload();
    const all = Object.values(materials.materials);
    if (all.some(({ map }) => map)) await done;
    for (const material of all) for (const slot of MAPS) if (!material[slot]?.image) material[slot] = null; // not dropped along
    for (const { color, specular } of all) {
      color.convertLinearToSRGB(); // the loader took it for sRGB
      specular.set(0); // as the tree is drawn later
    }
    loader.setMaterials(materials);
  }
  const object = loader.parse(await content.text());
  return { object };
}

async function readStl([{ content }]) {
  const { STLLoader } = await load("STL");
  return { object: clay(new STLLoader().parse(await content.arrayBuffer())) };
}

async function readPly([{ content }]) {
  const { PLYLoader } = await load("PLY");
  const geometry = new PLYLoader().parse(await content.arrayBuffer());
  return { object: geometry.index ? clay(geometry) : pointsOf(geometry) };
}

/** In the light and the soft foliage in which the tree that moves is drawn, so that nothing jumps. */
function drawAsTrees(object) {
  const whole = new THREE.Box3().setFromObject(object);
  object.traverse((node) => {
    if (!node.isMesh) return;
    const { geometry } = node;
    if (!geometry.attributes.normal) geometry.computeVertexNormals();
    const own = geometry.attributes.color;
    const { array: vertices } = geometry.attributes.position;
    const N = vertices.length / 3;
    const box = whole.clone().applyMatrix4(node.matrixWorld.clone().invert());
    if (!own && vertices instanceof Float32Array) {
      softenFoliage(geometry, { N, vertices, faces: geometry.index?.array, box });
    }
    const lit = [node.material].flat().map((material) => {
      const { color, map, alphaTest, transparent } = material;
      material.dispose();
      return new THREE.MeshLambertMaterial({
        color,
        map,
        vertexColors: Boolean(geometry.attributes.color),
        alphaTest: alphaTest || (transparent && map ? 0.5 : 0),
        side: THREE.DoubleSide,
        shadowSide: THREE.DoubleSide,
      });
    });
    node.material = lit.length === 1 ? lit[0] : lit;
    node.castShadow = node.receiveShadow = true;
  });
}

/** A mesh of a file without materials; of vertex colours, the light adds none. */
function clay(geometry) {
  return new THREE.Mesh(
    geometry,
    new THREE.MeshLambertMaterial({ color: geometry.attributes.color ? 0xffffff : CLAY }),
  );
}

/** What a comment in the head of a PLY file says is up; null if none does. */
function namedUp(head) {
  return UP_COMMENT.exec(head)?.[1] ?? (/^comment vertical axis: z\s*$/im.test(head) ? "+Z" : null);
}

async function readSplat([{ name, content }], { stage }) {
  const { sparkRenderer } = await import("./splat.js");
  const spark = await import("@sparkjsdev/spark");
  const object = new spark.SplatMesh({ fileBytes: new Uint8Array(await content.arrayBuffer()), fileName: name });
  await object.initialized;
  const renderer = sparkRenderer(spark, stage);
  object.add(renderer);
  const release = () => {
    object.remove(renderer);
    renderer.activeSplats = 0; // else it goes on drawing this one until it has sorted the next
  };
  return { object, box: object.getBoundingBox(true), sizeless: true, release };
}

function dispose(object) {
  object.traverse((node) => {
    node.geometry?.dispose?.();
    for (const material of [node.material ?? []].flat()) {
      material.map?.dispose();
      material.dispose?.();
    }
  });
  object.dispose?.();
}
