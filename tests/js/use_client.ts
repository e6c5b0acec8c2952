// Compiled, never run: a client that openapi-fetch makes of the types of openapi.json, used as people use it.
import createClient from "openapi-fetch";
import type { components, paths } from "./openapi";

type Job = components["schemas"]["JobPayload"];
const client = createClient<paths>({ baseUrl: "http://127.0.0.1:8000" });

export async function sway(assetId: string): Promise<string[]> {
  const { data, error } = await client.POST("/v1/jobs", {
    body: { type: "animate", asset_id: assetId, params: { formats: ["glb", "usd", "vat"] } },
  });
  if (error !== undefined) throw new Error(`${error.code}: ${error.detail} ${error.suggestion}`);
  if (!("stages" in data)) throw new Error("an estimate, not a job");
  let job: Job = data;
  while (job.state === "queued" || job.state === "running") {
    const answer = await client.GET("/v1/jobs/{id}", { params: { path: { id: job.id } } });
    if (answer.data === undefined) throw new Error(answer.error?.code);
    job = answer.data;
  }
  const { data: manifest } = await client.GET("/v1/jobs/{id}/artifacts", { params: { path: { id: job.id } } });
  // @ts-expect-error: a manifest has no such field
  void manifest?.mood;
  return (manifest?.artifacts ?? []).map((artifact) => `${artifact.name} ${artifact.facts?.max_error_m ?? 0}`);
}

export async function push(spectrumId: string): Promise<number[][][]> {
  const { data } = await client.POST("/v1/interact", {
    body: {
      spectrum_id: spectrumId, num_frames: 60,
      forces: [{ kind: "impulse", at: { voxel: 7 }, impulse_n_s: [0, 5, 0] }],
    },
  });
  return typeof data === "object" ? (data.groups[0]?.q ?? []) : []; // other media types are text
}
