// A tree as a folder for any web server: the page of a frame (/embed), the modules that it imports, and the tree's parts.

const IMPORTED = /(?:from|import)\s*\(?\s*"([^"]+)"/g;
const LINKED = /(?:href|src)="\.\/([^"]+)"/g;

/** Files `{ name, bytes }`; `parts` are the contents of surface, modes and maybe splat. `read(path)` gives a page file. */
export async function webFolder(parts, read) {
  const html = new TextDecoder().decode(await read("embed"));
  const map = JSON.parse(/<script type="importmap">(.*?)<\/script>/s.exec(html)[1]).imports;
  const left = parts.splat ? [] : ["@sparkjsdev/spark"]; // the largest of all, and for splats only
  const found = new Map();
  const take = async (path) => {
    if (found.has(path)) return;
    found.set(path, null);
    const bytes = await read(path);
    found.set(path, bytes);
    if (!path.endsWith(".js") || path.includes("/spark-")) return;
    const names = [...new TextDecoder().decode(bytes).matchAll(IMPORTED)].map(([, name]) => name);
    await Promise.all(names.map((name) => placeOf(name, path, map, left)).map((place) => place && take(place)));
  };
  await Promise.all([...html.matchAll(LINKED)].map(([, path]) => take(path)));
  const page = html.replace("<body ", `<body data-tree="./tree/" data-parts="${Object.keys(parts).join(" ")}" `);
  const tree = Object.entries(parts).map(([part, bytes]) => ({ name: `tree/${part}.safetensors`, bytes }));
  const files = [...found].map(([name, bytes]) => ({ name, bytes }));
  return [{ name: "index.html", bytes: new TextEncoder().encode(page) }, ...tree, ...files];
}

/** Where a module lies that another imports: beside it, or where the import map has its name. Null for what is not needed. */
function placeOf(name, from, map, left) {
  if (name.startsWith(".")) return new URL(name, new URL(from, "file:///")).pathname.slice(1);
  const prefix = Object.keys(map).find((one) => name === one || (one.endsWith("/") && name.startsWith(one)));
  if (!prefix || left.includes(prefix)) return null;
  return (map[prefix] + name.slice(prefix.length)).replace(/^\.\//, "");
}
