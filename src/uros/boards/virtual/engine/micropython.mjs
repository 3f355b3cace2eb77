// Runs a board's program on MicroPython (WebAssembly) for micropython.py.
//
//   node micropython.mjs MODULE ROOT SHIMS REQUESTS ANSWERS MEASURE CORE TICKS
//
// MODULE is micropython.mjs of the npm package, ROOT the board's file system, SHIMS the folder of
// the built-in modules. The program runs in a worker thread and blocks there, as on a board: each
// system call is written to the descriptor REQUESTS and waits for its answer from ANSWERS. The main
// thread reads stdin and ends the process at the end of stdin, which is also that of the parent
// process, even if the program is stuck. The line "heap" requests the heap in use. With MEASURE 1
// the heap is measured after each slice. CORE is the module that the second core runs; empty runs
// main.py. TICKS is JSON: the four numbers of BoardClock.ticks_formula, by which the ticks are
// computed here, because a program reads them at each turn; null requests them as all else.
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
const TICKS_MS = 2;
const HEAP = 23;
const IRQ_NEXT = 44;
// Octets after which a collection runs, as on a board whose heap fills up from time to time.
const THRESHOLD = 16384;

function supervise() {
  const asked = new Int32Array(new SharedArrayBuffer(4));
  const [module, root, shims, requests, answers, measure, core, ticks] = process.argv.slice(2);
  const worker = new Worker(new URL(import.meta.url), {
    workerData: {
      module, root, shims, asked, core,
      requests: Number(requests), answers: Number(answers), measure: measure === "1",
      ticks: JSON.parse(ticks),
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
  constructor(requests, answers, ticks) {
    this.requests = requests;
    this.answers = answers;
    this.out = Buffer.alloc(1024);
    this.in = Buffer.alloc(4096);
    this.parts = [];
    this.answer = Buffer.alloc(0);
    this.at = 0;
    this.printed = [];
    this.held = false; // an interrupt's handler runs, and sees the time of its edge
    this.formula = ticks && [BigInt(ticks[0]), BigInt(ticks[1]), ticks[2], BigInt(ticks[3])];
  }

  send(parts) {
    const length = parts.reduce((sum, part) => sum + part.length, 0);
    const out = length + 4 <= this.out.length ? this.out : Buffer.alloc(length + 4);
    out.writeUInt32LE(length);
    let end = 4;
    for (const part of parts) {
      out.set(part, end);
      end += part.length;
    }
    for (let at = 0; at < end;) at += writeSync(this.requests, out, at, end - at);
  }

  // An answer, without its length. Never more than one is under way.
  receive() {
    let data = this.in;
    let end = 4;
    let done = 0;
    while (done < end) {
      const count = readSync(this.answers, data, done, data.length - done, null);
      if (!count) process.exit(0); // the board's process has ended
      done += count;
      if (end === 4 && done >= 4) {
        end += data.readUInt32LE();
        if (end > data.length) data = Buffer.concat([data.subarray(0, done)], end);
      }
    }
    return data.subarray(4, end);
  }

  // The answer to TICKS_MS or TICKS_US; -1: only the board knows the time.
  ticks(operation) {
    if (!this.formula || this.held) return -1;
    const [powerOn, restarted, speed, rate] = this.formula;
    const since = process.hrtime.bigint() - powerOn;
    const world = speed === 1 ? since : BigInt(Math.trunc(Number(since) * speed));
    const ns = (world * rate) / 1000000000n - restarted;
    return Number(ns / (operation === TICKS_MS ? 1000000n : 1000n) & 0x3fffffffn);
  }

  write(data) {
    this.parts.push(Buffer.from(data));
    return data.length;
  }

  read(target) {
    if (this.parts.length) {
      this.flush();
      this.answer = this.call(this.parts.splice(0));
      this.at = 0;
    }
    const chunk = this.answer.subarray(this.at, this.at + target.length);
    target.set(chunk);
    this.at += chunk.length;
    return chunk.length;
  }

  call(parts) {
    const operation = parts[0][0];
    this.send(parts);
    if (operation === HEAP) return Buffer.alloc(5);
    const answer = this.receive();
    if (operation === IRQ_NEXT) this.held = answer.readUInt32LE(1) !== 0;
    return answer;
  }

  // Output is sent line by line, and before any other system call.
  print(data) {
    this.printed.push(Buffer.from(data));
    if (data.includes(10)) this.flush();
  }

  flush() {
    if (this.printed.length) this.send([Buffer.of(CONSOLE), ...this.printed.splice(0)]);
  }
}

// This build of MicroPython asserts at most calls of C that the table of functions is as it was, by
// WebAssembly.Table.get, which is slow. The table never changes.
function rememberTables() {
  const { get } = WebAssembly.Table.prototype;
  const known = new WeakMap();
  let last = null; // in nearly all calls the table of the call before
  let entries = null;
  WebAssembly.Table.prototype.get = function (index) {
    if (this !== last) {
      last = this;
      entries = known.get(this);
      if (!entries) known.set(this, entries = []);
    }
    return entries[index] ??= get.call(this, index);
  };
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

async function run({ module, root, shims, asked, core, requests, answers, measure, ticks }) {
  const line = new Line(requests, answers, ticks);
  const print = (data) => line.print(data);
  rememberTables();
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
  python.registerJsModule("_ticks", { ticks: (operation) => line.ticks(operation) });

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
