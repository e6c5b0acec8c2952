/** A small picture of a job's tree; null for none. */
export async function readStill(client, jobId, options) {
  const still = (await client.artifacts(jobId)).find(({ name }) => name === "still.webp");
  return still ? new Blob([await client.bytes(still.url, options)]) : null;
}
