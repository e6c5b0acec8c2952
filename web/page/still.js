// A small still of a job's tree: the first of the frames that its preview has side by side at its foot.

const FRAMES = 8; // as dynamictree/render/sheet.py lays them
const TALL = 232 / 160; // height of a frame in its width
export const PREVIEW = "preview.png"; // every job writes one

/** The address of the still in the content of a preview; to be revoked. */
export async function stillOf(bytes) {
  const sheet = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  const width = Math.floor(sheet.width / FRAMES);
  const height = Math.floor(TALL * width);
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d").drawImage(sheet, 0, sheet.height - height, width, height, 0, 0, width, height);
  sheet.close();
  return URL.createObjectURL(await canvas.convertToBlob({ type: "image/webp" }));
}
