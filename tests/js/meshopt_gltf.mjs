// Compressed GLB as glTF-Transform and meshoptimizer have it, from `make js-tools`.
//   node meshopt_gltf.mjs TOOLS play FILE         : JSON of the first primitive's vertices at every key of the animation
//   node meshopt_gltf.mjs TOOLS pack FILE TARGET  : write FILE with EXT_meshopt_compression, in the tool's own way
import { createRequire } from "node:module";
import { resolve } from "node:path";

const [tools, command, file, target] = process.argv.slice(2);
const require = createRequire(`${resolve(tools)}/`);
const { NodeIO } = require("@gltf-transform/core");
const { ALL_EXTENSIONS } = require("@gltf-transform/extensions");
const { meshopt } = require("@gltf-transform/functions");
const { MeshoptDecoder, MeshoptEncoder } = require("meshoptimizer");

await Promise.all([MeshoptDecoder.ready, MeshoptEncoder.ready]);
const io = new NodeIO()
  .registerExtensions(ALL_EXTENSIONS)
  .registerDependencies({ "meshopt.decoder": MeshoptDecoder, "meshopt.encoder": MeshoptEncoder });
const document = await io.read(file);
if (command === "pack") {
  await document.transform(meshopt({ encoder: MeshoptEncoder, level: "medium" }));
  await io.write(target, document);
} else {
  const primitive = document.getRoot().listMeshes()[0].listPrimitives()[0];
  const elements = (accessor) =>
    Array.from({ length: accessor.getCount() }, (_, row) => accessor.getElement(row, [])).flat();
  const rest = elements(primitive.getAttribute("POSITION"));
  const targets = primitive.listTargets().map((one) => elements(one.getAttribute("POSITION")));
  const weights = document.getRoot().listAnimations()[0].listSamplers()[0].getOutput().getArray();
  const frames = [];
  for (let key = 0; key * targets.length < weights.length; key += 20) {
    const own = weights.subarray(key * targets.length, (key + 1) * targets.length);
    frames.push(rest.map((value, i) => targets.reduce((sum, row, m) => sum + own[m] * row[i], value)));
  }
  process.stdout.write(JSON.stringify(frames));
}
