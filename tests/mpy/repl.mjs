// A board's console for repl.py: MicroPython's own REPL and raw REPL (WebAssembly), whose line is
// stdin and stdout. What is modelled is the rest of a board: a soft reset is a new interpreter, the
// flash is /flash, boot.py and main.py there are started as boards start them, and raw paste, for
// which this build has no input, hands its code to the raw REPL.
//
//   node repl.mjs MODULE PASTE
//
// PASTE is 1, 0 for a board that knows raw paste and has none, "old" for one that does not know it.
//
// A program imports `hw`: hw.wait() blocks until an octet comes over the line and returns it, as a
// sleep does on a board that Ctrl-C interrupts; hw.wait_deaf() does not let itself be interrupted.

import { readSync, writeSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { loadMicroPython } = await import(pathToFileURL(process.argv[2]));
const PASTE = process.argv[3];
const CTRL_A = 1, CTRL_B = 2, CTRL_C = 3, CTRL_D = 4, CTRL_E = 5;
const WINDOW = 128;

let muted = false;
let raw = false;
let skipped = 0; // so many octets are not to be seen

function out(bytes) {
  let rest = muted ? Buffer.alloc(0) : Buffer.from(bytes);
  const dropped = Math.min(skipped, rest.length);
  skipped -= dropped;
  rest = rest.subarray(dropped);
  while (rest.length) rest = rest.subarray(writeSync(1, rest));
}

// This build numbers errors as WASI does, and boards as Linux does, which mpremote looks at.
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
        it = getattr(os, name)
        setattr(module, name, numbered(it) if name in LIST else it)
    sys.modules["os"] = module
    builtins.open = numbered(open)
LIST = ("stat", "remove", "rename", "mkdir", "rmdir", "chdir", "ilistdir", "listdir", "statvfs")
linux()
del linux, LIST
`;

const one = Buffer.alloc(1);
function octet() {
  if (!readSync(0, one, 0, 1, null)) process.exit(0); // the test is over
  return one[0];
}

// What the flash holds, out of one interpreter and into the next one.
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
  // Lines end on boards as terminals want them.
  const lined = (bytes) => out(bytes[0] === 10 ? [13, 10] : bytes);
  let cooked = true;
  const python = await loadMicroPython({
    linebuffer: false, heapsize: 262144,
    stdout: (bytes) => (cooked ? lined(bytes) : out(bytes)),
  });
  const interrupt = (byte) => {
    if (byte === CTRL_C) python._module._mp_sched_keyboard_interrupt();
    return byte;
  };
  python.registerJsModule("hw", { wait: () => interrupt(octet()), wait_deaf: () => octet() });
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
  cooked = false; // the REPL does that itself, but for what code prints
  muted = raw;
  python.replInit();
  muted = false;
  if (raw) python.replProcessChar(CTRL_A);
  return python;
}

// What follows Ctrl-E in the raw REPL.
function paste() {
  const rest = [octet(), octet()];
  if (PASTE === "0") {
    out([82, 0]);
    return;
  }
  if (PASTE === "old") {
    python.replProcessChar(CTRL_A); // the others are code to it, which this drops
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
