// Runs MicroPython as WebAssembly for harness.py. Each line on stdin is a JSON request, each line on
// stdout its JSON answer.
//
//   {"do": "write", "path": P, "base64": B}  write a file in MicroPython's file system
//   {"do": "run", "source": S}               run Python code in __main__
//   {"do": "heap"}                           collect garbage; bytes in use on the heap
//
// An answer is {"output": the printed text, "error": the traceback or null, "heap": a number}.

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

// This build sweeps its heap only when a call returns to JavaScript, so the collection and the
// measurement are two calls.
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
