// Compressed GLB as glTF-Transform and meshoptimizer have it, from `make js-tools`.
//   node meshopt_gltf.mjs TOOLS read FILE         : JSON of the first primitive's positions
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
  const positions = primitive.getAttribute("POSITION");
  const rows = Array.from({ length: positions.getCount() }, (_, row) => positions.getElement(row, []));
  process.stdout.write(JSON.stringify(rows.flat()));
}
