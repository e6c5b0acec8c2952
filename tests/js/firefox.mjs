// The page in Firefox, by WebDriver BiDi: the welcome's tree, an uploaded one, a drag, axe-core. Prints what it saw as JSON.
//   node firefox.mjs TOOLS URL TREE FOLDER : screenshots are written to FOLDER
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";

const [tools, url, tree, folder] = process.argv.slice(2);
const require = createRequire(`${resolve(tools)}/`);
const puppeteer = require("puppeteer-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const LONG_MS = 240_000;
const MOST_TURNS = 90;
const GRID = { columns: 24, rows: 24 };

const browser = await puppeteer.launch({
  browser: "firefox",
  executablePath: process.env.FIREFOX_PATH,
  headless: false, // only with a display, if a virtual one, does it draw WebGL
  defaultViewport: null,
  args: ["--width=1100", "--height=800"],
  extraPrefsFirefox: { "webgl.force-enabled": true },
});
const seen = { complaints: [] };
try {
  const page = await browser.newPage();
  const heard = (type, words) => seen.complaints.push(`${type}: ${words}`);
  page.on("console", (message) => {
    if (["error", "warn"].includes(message.type())) heard(message.type(), message.text());
  });
  page.on("pageerror", (error) => heard("exception", error.message));
  const state = (name) => page.waitForSelector(`body[data-${name}]`, { timeout: LONG_MS });
  const violations = async () => {
    await page.evaluate(axe);
    const found = await page.evaluate(() => window.axe.run());
    return found.violations.map(({ id }) => id);
  };
  const shot = async (name) => Buffer.from(await page.screenshot({ path: `${folder}/firefox-${name}.png` }));

  await page.goto(url);
  await state("ready");
  await state("live=true");
  seen.welcomeMoves = !(await shot("welcome")).equals(await shot("welcome-later"));
  seen.welcomeViolations = await violations();

  await (await page.$("#files")).uploadFile(tree);
  await state("state=moving");
  await page.click("#play"); // stands still, so that only the pull moves it
  await state("sharp=true");
  let [before, standing] = [null, await shot("standing")];
  for (let turn = 0; turn < MOST_TURNS && !before?.equals(standing); turn++) {
    await new Promise((done) => setTimeout(done, 1000)); // the hint goes, and the picture gets its last pixels
    [before, standing] = [standing, await shot("standing")];
  }
  seen.standsStill = before.equals(standing);
  const place = await onTheTree(page);
  await page.mouse.move(place.x, place.y);
  await page.mouse.down();
  await page.mouse.move(place.x + 90, place.y, { steps: 8 });
  await new Promise((done) => setTimeout(done, 1500));
  seen.pulled = !standing.equals(await shot("pulled"));
  await page.mouse.up();
  seen.movingViolations = await violations();
} finally {
  await browser.close();
}
console.log(JSON.stringify(seen));

/** Where the pointer says that it can take hold of a branch. */
async function onTheTree(page) {
  const { width, height } = await page.evaluate(() => document.getElementById("canvas").getBoundingClientRect().toJSON());
  for (let row = 2; row < GRID.rows; row++)
    for (let column = GRID.columns / 4; column < GRID.columns / 2; column++) {
      const place = { x: (width * column) / GRID.columns, y: (height * row) / GRID.rows };
      await page.mouse.move(place.x, place.y);
      if (await page.evaluate(() => document.getElementById("canvas").classList.contains("over"))) return place;
    }
  throw new Error("the pointer is nowhere on the tree");
}
