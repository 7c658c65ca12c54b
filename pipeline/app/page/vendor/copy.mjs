// Copies the libraries of the page from node_modules to this folder: `npm run vendor`. The copies are committed, so that
// neither a user nor a test needs npm or the network.
import { copyFileSync, readFileSync, writeFileSync } from "node:fs";

// Of each copy: package, module in it, and the imports that a browser cannot resolve without an import map.
const MODULES = {
  "preact.js": ["preact", "dist/preact.mjs", {}],
  "hooks.js": ["preact", "hooks/dist/hooks.mjs", { '"preact"': '"./preact.js"' }],
  "htm.js": ["htm", "dist/htm.mjs", {}],
};

for (const [copy, [name, file, imports]] of Object.entries(MODULES)) {
  const { version, license } = JSON.parse(readFileSync(`node_modules/${name}/package.json`, "utf8"));
  let source = readFileSync(`node_modules/${name}/${file}`, "utf8").replace(/\n?\/\/# sourceMappingURL=.*\s*$/, "");
  for (const [bare, relative] of Object.entries(imports)) {
    if (!source.includes(bare)) throw new Error(`${name}/${file} does not import ${bare}`);
    source = source.replaceAll(bare, relative);
  }
  writeFileSync(copy, `/*! ${name} ${version}, ${license}; see ${name}.LICENSE. Written by copy.mjs. */\n${source.trimEnd()}\n`);
  copyFileSync(`node_modules/${name}/LICENSE`, `${name}.LICENSE`);
}
