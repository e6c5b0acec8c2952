/** The first of the frames at the foot of a job's preview. */

const WIDTH = 160;
const HEIGHT = 232;

export async function readStill(client, jobId, options) {
  const preview = (await client.artifacts(jobId)).find(({ name }) => name === "preview.png");
  const sheet = await createImageBitmap(new Blob([await client.bytes(preview.url, options)]));
  const canvas = new OffscreenCanvas(WIDTH, HEIGHT);
  canvas.getContext("2d").drawImage(sheet, 0, HEIGHT - sheet.height);
  return canvas.convertToBlob({ type: "image/webp", quality: 0.8 });
}
