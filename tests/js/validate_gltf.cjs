// node validate_gltf.cjs FOLDER_OF_NODE_MODULES FILE… prints the issues of each file, as JSON.
const { readFileSync } = require("node:fs");
const { createRequire } = require("node:module");
const validator = createRequire(process.argv[2] + "/")("gltf-validator");

(async () => {
  const reports = [];
  for (const path of process.argv.slice(3)) {
    const report = await validator.validateBytes(new Uint8Array(readFileSync(path)), { maxIssues: 200 });
    reports.push(report.issues);
  }
  console.log(JSON.stringify(reports));
})();
