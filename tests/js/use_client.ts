// use_client URL FILE PORT: upload, wait, receive the webhook and download through a client of openapi-fetch.
import { createHash, createHmac } from "node:crypto";
import { once } from "node:events";
import { readFile } from "node:fs/promises";
import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import { basename } from "node:path";
import createClient from "openapi-fetch";
import type { components, paths, webhooks } from "./openapi";

type Job = components["schemas"]["JobPayload"];
type Ended = webhooks["job.succeeded"]["post"]["requestBody"]["content"]["application/json"];

const [url, file, port] = process.argv.slice(2) as [string, string, string];
const client = createClient<paths>({ baseUrl: url });

function answered<T>({ data, error }: { data?: T; error?: components["schemas"]["Problem"] }): T {
  if (error !== undefined) throw new Error(`${error.code}: ${error.detail} ${error.suggestion}`);
  return data as T;
}

const server = createServer().listen(Number(port), "127.0.0.1");
const delivered = once(server, "request") as Promise<[IncomingMessage, ServerResponse]>;
const endpoint = answered(await client.POST("/v1/webhook-endpoints", { body: { url: `http://127.0.0.1:${port}/` } }));

const form = new FormData();
form.append("file", new Blob([await readFile(file)]), basename(file));
const asset = answered(await client.POST("/v1/assets", { body: { file: [] }, bodySerializer: () => form }));

const params: components["schemas"]["AnimateParams"] = { formats: ["glb"], num_steps: 1 };
const body: components["schemas"]["AnimateRequest"] = { type: "animate", asset_id: asset.id, seed: 12, params };
const headers = { "idempotency-key": "typescript" };
let job: Job = answered(await client.POST("/v1/jobs", { body, params: { header: headers } }));
const path = { id: job.id };
while (job.state === "queued" || job.state === "running") {
  job = answered(await client.GET("/v1/jobs/{id}", { params: { path, header: { prefer: "wait=20" } } }));
}
if (job.state !== "succeeded") throw new Error(JSON.stringify(job));

const [request, response] = await delivered;
let text = "";
for await (const piece of request) text += piece;
response.writeHead(204).end();
server.close();
answered(await client.DELETE("/v1/webhook-endpoints/{id}", { params: { path: { id: endpoint.id } } }));
const signed = `${request.headers["webhook-id"]}.${request.headers["webhook-timestamp"]}.${text}`;
const key = Buffer.from(endpoint.secret.slice("whsec_".length), "base64");
const signature = `v1,${createHmac("sha256", key).update(signed).digest("base64")}`;
if (!String(request.headers["webhook-signature"]).split(" ").includes(signature)) throw new Error("signature");
const event = JSON.parse(text) as Ended;
console.log("event", event.type, event.data.id === job.id);

const manifest = answered(await client.GET("/v1/jobs/{id}/artifacts", { params: { path } }));
// @ts-expect-error: a manifest has no such field
void manifest.mood;
const artifact = manifest.artifacts.find((each) => each.name.endsWith(".glb"));
if (artifact === undefined) throw new Error("no GLB");
const download = { params: { path: { id: artifact.id } }, parseAs: "arrayBuffer" } as const;
const bytes = answered(await client.GET("/v1/artifacts/{id}", download));
console.log("file", artifact.name, createHash("sha256").update(Buffer.from(bytes)).digest("hex") === artifact.sha256);

const spectrum_id = job.result?.spectrum_id ?? "";
const push: components["schemas"]["ForcePayload"] = { kind: "impulse", at: { voxel: 7 }, impulse_n_s: [0, 5, 0] };
const swing = answered(await client.POST("/v1/interact", { body: { spectrum_id, num_frames: 60, forces: [push] } }));
if (typeof swing !== "object" || swing.groups[0]?.q.length !== 60) throw new Error("no motion");

const missing = await client.GET("/v1/jobs/{id}", { params: { path: { id: "0".repeat(26) } } });
console.log("refused", missing.response.status);
