// A board's console for repl.py: the REPL and raw REPL of MicroPython (WebAssembly) on stdin and
// stdout. This program models the rest of a board: a soft reset creates a new interpreter, the flash
// is the folder /flash, and boot.py and main.py run at the start. This build has no raw paste; its
// code is passed to the raw REPL.
//
//   node repl.mjs MODULE PASTE
//
// PASTE is 1 for a board with raw paste, 0 for a board that refuses raw paste, "old" for a board
// that does not know the request.
//
// Programs can import `hw`: hw.wait() blocks until an octet arrives on the line and returns it;
// Ctrl-C interrupts it, as a sleep on a board. Ctrl-C does not interrupt hw.wait_deaf(). sys.stdin is
// the line, too; poll() says always that it is readable, so programs call hw.sleep(ms) in between.

import { readSync, writeSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { loadMicroPython } = await import(pathToFileURL(process.argv[2]));
const PASTE = process.argv[3];
const CTRL_A = 1, CTRL_B = 2, CTRL_C = 3, CTRL_D = 4, CTRL_E = 5;
const WINDOW = 128;

let muted = false;
let raw = false;
let skipped = 0; // octets of output that are still to be dropped

function out(bytes) {
  let rest = muted ? Buffer.alloc(0) : Buffer.from(bytes);
  const dropped = Math.min(skipped, rest.length);
  skipped -= dropped;
  rest = rest.subarray(dropped);
  while (rest.length) rest = rest.subarray(writeSync(1, rest));
}

// This build has the error numbers of WASI, boards those of Linux, which mpremote evaluates.
const LINUX_ERRORS = `
def linux():
    import builtins, os, sys
    def numbered(call):
        def wrapped(*args, **kwargs):
            try:
                return call(*args, **kwargs)
            except OSError as error:
                raise OSError({20: 17, 31: 21, 44: 2, 54: 20, 55: 39}.get(error.errno, error.errno))
        return wrapped
    class Module: pass
    module = Module()
    for name in dir(os):
        value = getattr(os, name)
        setattr(module, name, numbered(value) if name in LIST else value)
    sys.modules["os"] = module
    builtins.open = numbered(open)
LIST = ("stat", "remove", "rename", "mkdir", "rmdir", "chdir", "ilistdir", "listdir", "statvfs")
linux()
del linux, LIST
`;

const received = Buffer.alloc(1);
const never = new Int32Array(new SharedArrayBuffer(4));
const sleep = (ms) => void Atomics.wait(never, 0, 0, ms);

// Returns the next octet of the line, which does not block; null if there is none.
function available() {
  try {
    if (!readSync(0, received, 0, 1, null)) process.exit(0); // the test has ended
  } catch (error) {
    if (error.code !== "EAGAIN") throw error;
    return null;
  }
  return received[0];
}

function octet() {
  for (;;) {
    const byte = available();
    if (byte !== null) return byte;
    sleep(1);
  }
}

// Returns the folders and files of the flash, which the next interpreter gets.
function tree(FS, folder, files = []) {
  for (const name of FS.readdir(folder)) {
    if (name === "." || name === "..") continue;
    const path = `${folder}/${name}`;
    if (FS.isDir(FS.stat(path).mode)) {
      files.push([path, null]);
      tree(FS, path, files);
    } else files.push([path, FS.readFile(path)]);
  }
  return files;
}

async function boot(files) {
  // Boards end lines with CR LF.
  const lined = (bytes) => out(bytes[0] === 10 ? [13, 10] : bytes);
  let cooked = true;
  const python = await loadMicroPython({
    linebuffer: false, heapsize: 262144, stdin: available,
    stdout: (bytes) => (cooked ? lined(bytes) : out(bytes)),
  });
  // sys.stdout.buffer does not end lines with CR LF on boards; here a program says when it is used.
  const plain = (wanted) => void (cooked = !wanted);
  const interrupt = (byte) => {
    if (byte === CTRL_C) python._module._mp_sched_keyboard_interrupt();
    return byte;
  };
  python.registerJsModule("hw", { wait: () => interrupt(octet()), wait_deaf: () => octet(), sleep, plain });
  python.runPython(LINUX_ERRORS);
  python.FS.mkdirTree("/flash");
  for (const [path, data] of files) {
    if (data === null) python.FS.mkdirTree(path);
    else python.FS.writeFile(path, data);
  }
  python.runPython(
    "import os, sys; os.chdir('/flash'); sys.path[:] = ['', '.frozen', '/flash', '/flash/lib']",
  );
  for (const name of raw ? ["boot.py"] : ["boot.py", "main.py"]) {
    if (!python.FS.analyzePath(`/flash/${name}`).exists) continue;
    try {
      python.runPython(`exec(compile(open('/flash/${name}').read(), '${name}', 'exec'))`);
    } catch (error) {
      if (error.name !== "PythonError") throw error;
      out(Buffer.from(error.message.replaceAll("\n", "\r\n")));
    }
  }
  cooked = false; // the REPL ends lines so itself, except in the output of programs
  muted = raw;
  python.replInit();
  muted = false;
  if (raw) python.replProcessChar(CTRL_A);
  return python;
}

// Handles raw paste: Ctrl-E in the raw REPL, followed by "A" and Ctrl-A.
function paste() {
  octet();
  octet();
  if (PASTE === "0") {
    out([82, 0]);
    return;
  }
  if (PASTE === "old") {
    // Such a board takes Ctrl-E and "A" as code, which Ctrl-A drops.
    python.replProcessChar(CTRL_A);
    return;
  }
  out([82, 1, WINDOW, 0]);
  const code = [];
  let room = WINDOW;
  for (let byte = octet(); byte !== CTRL_D; byte = octet()) {
    if (byte === CTRL_C) return out(Buffer.from("\x04\x04KeyboardInterrupt\r\n\x04>"));
    code.push(byte);
    if (--room === 0) {
      room = WINDOW;
      out([1]);
    }
  }
  out([CTRL_D]);
  muted = true;
  for (const byte of code) python.replProcessChar(byte);
  muted = false;
  skipped = 2; // "OK"
  python.replProcessChar(CTRL_D);
}

let python = await boot([]);
for (;;) {
  const byte = octet();
  if (raw && byte === CTRL_E) {
    paste();
    continue;
  }
  if (byte === CTRL_A) raw = true;
  if (byte === CTRL_B) raw = false;
  if (python.replProcessChar(byte)) {
    out(Buffer.from("MPY: soft reboot\r\n"));
    python = await boot(tree(python.FS, "/flash"));
  }
}
