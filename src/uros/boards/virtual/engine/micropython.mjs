// Runs a board's program on MicroPython (WebAssembly) for micropython.py.
//
//   node micropython.mjs MODULE ROOT SHIMS REQUESTS ANSWERS MEASURE CORE
//
// MODULE is micropython.mjs of the npm package, ROOT the board's file system, SHIMS the folder of
// the built-in modules. The program runs in a worker thread and blocks there, as on a board: each
// system call is written to the descriptor REQUESTS and waits for its answer from ANSWERS. The main
// thread reads stdin and ends the process at the end of stdin, which is also that of the parent
// process, even if the program is stuck. The line "heap" requests the heap in use. With MEASURE 1
// the heap is measured after each slice. CORE is the module that the second core runs; empty runs
// main.py.
//
// A request is u32 length, operation, data. An answer is u32 length, error number or 0, u32 number
// or length of data, data; see shims/_host.py. CONSOLE and HEAP have no answer.
//
// This build of MicroPython sweeps its heap only when Python has returned to JavaScript. So a
// main.py that has start() and step() at its top level is imported, and this program calls step().

import { readFileSync, readdirSync, readSync, writeSync } from "node:fs";
import { createInterface } from "node:readline";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { Worker, isMainThread, workerData } from "node:worker_threads";

const CONSOLE = 1;
const HEAP = 23;
// Octets after which a collection runs, as on a board whose heap fills up from time to time.
const THRESHOLD = 16384;

function supervise() {
  const asked = new Int32Array(new SharedArrayBuffer(4));
  const [module, root, shims, requests, answers, measure, core] = process.argv.slice(2);
  const worker = new Worker(new URL(import.meta.url), {
    workerData: {
      module, root, shims, asked, core,
      requests: Number(requests), answers: Number(answers), measure: measure === "1",
    },
  });
  worker.on("error", (error) => {
    console.error(error);
    process.exit(1);
  });
  worker.on("exit", () => process.exit(0));
  const lines = createInterface({ input: process.stdin });
  lines.on("line", () => {
    Atomics.store(asked, 0, 1);
    Atomics.notify(asked, 0);
  });
  lines.on("close", () => process.exit(0));
}

// The system calls of the firmware, through the device file /dev/board: the firmware writes an
// operation and its data, and its first read after that carries them out.
class Line {
  constructor(requests, answers) {
    this.requests = requests;
    this.answers = answers;
    this.parts = [];
    this.answer = Buffer.alloc(0);
    this.at = 0;
    this.printed = [];
  }

  send(operation, parts) {
    const length = parts.reduce((sum, part) => sum + part.length, operation.length);
    const head = Buffer.alloc(4);
    head.writeUInt32LE(length);
    let rest = Buffer.concat([head, operation, ...parts]);
    while (rest.length) rest = rest.subarray(writeSync(this.requests, rest));
  }

  receive(length) {
    const data = Buffer.alloc(length);
    let done = 0;
    while (done < length) {
      const count = readSync(this.answers, data, done, length - done, null);
      if (!count) process.exit(0); // the board's process has ended
      done += count;
    }
    return data;
  }

  write(data) {
    this.parts.push(Buffer.from(data));
    return data.length;
  }

  read(target) {
    if (this.parts.length) {
      this.flush();
      const [operation, ...data] = this.parts.splice(0);
      this.send(operation, data);
      if (operation[0] === HEAP) this.answer = Buffer.alloc(5);
      else this.answer = this.receive(this.receive(4).readUInt32LE());
      this.at = 0;
    }
    const chunk = this.answer.subarray(this.at, this.at + target.length);
    target.set(chunk);
    this.at += chunk.length;
    return chunk.length;
  }

  // Output is sent line by line, and before any other system call.
  print(data) {
    this.printed.push(Buffer.from(data));
    if (data.includes(10)) this.flush();
  }

  flush() {
    if (this.printed.length) this.send(Buffer.of(CONSOLE), this.printed.splice(0));
  }
}

function copy(FS, from, to) {
  FS.mkdirTree(to);
  for (const entry of readdirSync(from, { withFileTypes: true })) {
    const source = join(from, entry.name);
    const target = `${to}/${entry.name}`;
    if (entry.isDirectory()) copy(FS, source, target);
    else FS.writeFile(target, readFileSync(source));
  }
}

async function run({ module, root, shims, asked, core, requests, answers, measure }) {
  const line = new Line(requests, answers);
  const print = (data) => line.print(data);
  const { loadMicroPython } = await import(pathToFileURL(module));
  const python = await loadMicroPython({ stdout: print, stderr: print, linebuffer: false });
  const { FS } = python;
  copy(FS, shims, "/shims");
  copy(FS, root, "/flash");
  const device = FS.makedev(64, 0);
  FS.registerDevice(device, {
    open(stream) { stream.seekable = false; },
    close() {},
    write: (stream, buffer, offset, length) => line.write(buffer.subarray(offset, offset + length)),
    read: (stream, buffer, offset, length) => line.read(buffer.subarray(offset, offset + length)),
  });
  FS.mkdev("/dev/board", device);

  const source = FS.readFile("/flash/main.py", { encoding: "utf8" });
  const sliced = /^def start\(/m.test(source) && /^def step\(/m.test(source);
  python.runPython(`
import gc, os, sys
os.chdir("/flash")
sys.path[:] = ["/shims", "", ".frozen", "/lib"]
import _boot
for name in ("machine", "select", "time", "usb.device.cdc"):
    __import__(name)
sys.path[:] = ["", ".frozen", "/lib", "/shims"]
del os, name
gc.threshold(${THRESHOLD})
`);
  const boot = python.pyimport("_boot");
  const { collect, report, run: begin, step } = boot;
  const answerHeap = () => {
    collect();
    report();
  };
  if (!core) answerHeap(); // before the program: the heap of the shims and of MicroPython itself
  if (measure && sliced) {
    const imports = /^(?:import|from) [^(\n]*(?:\([^)]*\))?.*$/gm; // parentheses span lines
    for (const statement of source.match(imports) ?? []) boot.imported(statement);
  }
  let more = core ? boot.run_core(core) : begin(sliced, measure);
  while (more) {
    more = step();
    if (Atomics.compareExchange(asked, 0, 1, 0) === 1) answerHeap();
  }
  // After its end the program stays in memory, and its heap can be requested.
  for (;;) {
    Atomics.wait(asked, 0, 0);
    Atomics.store(asked, 0, 0);
    answerHeap();
  }
}

if (isMainThread) supervise();
else await run(workerData);
