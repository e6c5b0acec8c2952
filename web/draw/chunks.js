// Parts of three.js' shaders are replaced by their names; a name that three.js does not have any more stops the page at once.

/**
 * A shader with parts replaced: keys are names of included chunks, or whole pieces of code. `$&` stands for what was there.
 */
export function replaced(source, parts) {
  return Object.entries(parts).reduce((code, [name, part]) => {
    const there = /^\w+$/.test(name) ? `#include <${name}>` : name;
    if (!code.includes(there)) throw new Error(`three.js' shader has no ${there}`);
    return code.replace(there, () => part.replace("$&", () => there));
  }, source);
}
