// What a job's GLB says of its materials beyond their colour: metal, roughness, and maps of normals. The file is read
// in pieces: its JSON, and the pictures of these maps.

import * as THREE from "three";

const HEAD_BYTES = 20; // of the file, and of its JSON
const JSON_MOST = 16e6;

/**
 * One entry per material of the file, null where a matt colour is all; null where that holds of all of them.
 * `read(from, to)` gives bytes of the file.
 */
export async function readLooks(read) {
  const head = new DataView(await read(0, HEAD_BYTES));
  const length = head.getUint32(12, true);
  if (length > JSON_MOST) return null;
  const json = JSON.parse(new TextDecoder().decode(await read(HEAD_BYTES, HEAD_BYTES + length)));
  const binary = HEAD_BYTES + length + 8;
  const picture = pictureReader(json, (from, to) => read(binary + from, binary + to));
  const looks = await Promise.all((json.materials ?? []).map((material) => readLook(material, picture)));
  return looks.some(Boolean) ? looks : null;
}

async function readLook({ pbrMetallicRoughness: surface = /** @type {any} */ ({}), normalTexture }, picture) {
  const { metallicFactor: metalness = 1, roughnessFactor: roughness = 1 } = surface;
  const base = surface.baseColorTexture;
  const own = (reference) => reference && samePlace(reference, base) && picture(reference);
  const [normalMap, roughnessMap] = await Promise.all([own(normalTexture), own(surface.metallicRoughnessTexture)]);
  // a file that says nothing is metal by the letter, which no tree is
  const says = "metallicFactor" in surface || roughnessMap;
  const matt = (!says || metalness === 0) && roughness === 1;
  if (matt && !normalMap) return null;
  return {
    metalness: says ? metalness : 0,
    roughness,
    metalnessMap: roughnessMap ?? null,
    roughnessMap: roughnessMap ?? null,
    normalMap: normalMap ?? null,
    // v runs downward, and the tangents are the shader's own
    normalScale: new THREE.Vector2(1, -1).multiplyScalar(normalTexture?.scale ?? 1),
  };
}

/** Whether a map lies where the colours do: the surface has one set of coordinates. */
const samePlace = (map, base) => !map.extensions && !base?.extensions && (map.texCoord ?? 0) === (base?.texCoord ?? 0);

function pictureReader({ textures = [], images = [], bufferViews = [] }, read) {
  const made = new Map(); // by texture: maps of several materials may be one
  const make = async (index) => {
    const view = bufferViews[images[textures[index]?.source]?.bufferView];
    if (!view || (view.buffer ?? 0) !== 0) return null;
    const from = view.byteOffset ?? 0;
    const blob = new Blob([await read(from, from + view.byteLength)]);
    const texture = new THREE.Texture(await createImageBitmap(blob, { colorSpaceConversion: "none" }));
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    texture.flipY = false;
    texture.anisotropy = 4;
    texture.needsUpdate = true;
    return texture;
  };
  return ({ index }) => {
    if (!made.has(index)) made.set(index, make(index));
    return made.get(index);
  };
}
