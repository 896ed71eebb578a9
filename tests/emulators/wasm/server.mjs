// MicroPython, compiled to WebAssembly: one JSON string of Python a line in, one JSON array [printed, error] a line out.
// Arguments: the folder of node_modules, then files to be importable.

import { readFileSync } from "node:fs";
import { basename, join } from "node:path";
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const [modules, ...files] = process.argv.slice(2);
const entry = join(modules, "node_modules/@micropython/micropython-webassembly-pyscript/micropython.mjs");
const { loadMicroPython } = await import(pathToFileURL(entry));

let printed = "";
const python = await loadMicroPython({ linebuffer: true, stdout: (text) => (printed += text + "\n") });
for (const file of files) python.FS.writeFile("/" + basename(file), readFileSync(file, "utf8"));

for await (const line of createInterface({ input: process.stdin })) {
  let error = null;
  printed = "";
  try {
    python.runPython(JSON.parse(line));
  } catch (exception) {
    error = String(exception.message);
  }
  process.stdout.write(JSON.stringify([printed, error]) + "\n");
}
