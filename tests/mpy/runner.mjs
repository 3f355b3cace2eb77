// Runs MicroPython as WebAssembly for harness.py: one JSON request a line on stdin, one JSON
// answer a line on stdout.
//
//   {"do": "write", "path": P, "base64": B}  a file in MicroPython's file system
//   {"do": "run", "source": S}               a piece of Python, in __main__
//   {"do": "heap"}                           bytes that are alive on its heap
//
// An answer is {"output": what was printed, "error": the traceback or null, "heap": a number}.

import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const { loadMicroPython } = await import(pathToFileURL(process.argv[2]));

const printed = [];
const keep = (bytes) => printed.push(Buffer.from(bytes));
const python = await loadMicroPython({ stdout: keep, stderr: keep, linebuffer: false });

function write({ path, base64 }) {
  python.FS.mkdirTree(path.slice(0, path.lastIndexOf("/")) || "/");
  python.FS.writeFile(path, Buffer.from(base64, "base64"));
  return {};
}

function run({ source }) {
  try {
    python.runPython(source);
  } catch (error) {
    if (error.name !== "PythonError") throw error;
    return { error: error.message.trimEnd() };
  }
  return {};
}

// This build sweeps its heap only when a call has come back to JavaScript, so asking and reading
// are two calls.
function heap() {
  python.runPython("import gc; gc.collect()");
  python.runPython("import gc; _heap_in_use = gc.mem_alloc()");
  return { heap: python.globals.get("_heap_in_use") };
}

const actions = { write, run, heap };

for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  const answer = { error: null, heap: 0, ...actions[request.do](request) };
  answer.output = Buffer.concat(printed.splice(0)).toString();
  process.stdout.write(JSON.stringify(answer) + "\n");
}
