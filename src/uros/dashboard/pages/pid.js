"use strict";
// Shows the last hundred samples, and sends gains. Columns of a sample:
// torque right, left, speed right, left, target right, left.

const HISTORY = 100;
const at = (id) => document.getElementById(id);
const colour = (name) => {
  const probe = document.createElement("i");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
};
let version = -1;
let drawn = null;
let shownNotes = "";

// --- the plot ---------------------------------------------------------------------------

// A step of 1, 2 or 5 times a power of ten that makes four to eight lines of the span.
function step(span) {
  const raw = span / 6;
  const power = 10 ** Math.floor(Math.log10(raw));
  for (const one of [1, 2, 5]) if (raw <= one * power) return one * power;
  return 10 * power;
}

function plot(canvas, samples, count, lines, least) {
  const dense = window.devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const high = Number(canvas.dataset.tall);
  canvas.width = width * dense;
  canvas.height = high * dense;
  canvas.style.height = `${high}px`;
  const pen = canvas.getContext("2d");
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  pen.clearRect(0, 0, width, high);
  let low = 0;
  let top = 0;
  for (const sample of samples) {
    for (const { column } of lines) {
      if (sample.length > column) {
        low = Math.min(low, sample[column]);
        top = Math.max(top, sample[column]);
      }
    }
  }
  if (top - low < least) {
    if (low < 0 && top === 0) low = -least;
    else top = low + least;
  }
  const grid = step(top - low);
  low = Math.floor(low / grid) * grid;
  top = Math.ceil(top / grid) * grid;
  const box = { left: 56, right: width - 10, top: 8, bottom: high - 34 };
  const x = (frame) => box.left + ((frame - (count - HISTORY)) / (HISTORY - 1)) * (box.right - box.left);
  const y = (value) => box.bottom - ((value - low) / (top - low)) * (box.bottom - box.top);

  pen.font = '12px system-ui, "DejaVu Sans", sans-serif';
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (let value = low; value <= top + grid / 2; value += grid) {
    pen.strokeStyle = colour(Math.abs(value) < grid / 2 ? "--faint" : "--line");
    pen.beginPath();
    pen.moveTo(box.left, Math.round(y(value)) + 0.5);
    pen.lineTo(box.right, Math.round(y(value)) + 0.5);
    pen.stroke();
    pen.fillStyle = colour("--faint");
    pen.fillText(String(Math.round(value)), box.left - 6, y(value));
  }
  pen.textBaseline = "top";
  pen.textAlign = "center";
  const first = count - HISTORY;
  for (let frame = Math.ceil(first / 20) * 20; frame < count; frame += 20) {
    if (frame >= 0) pen.fillText(String(frame), x(frame), box.bottom + 4);
  }
  pen.fillText("frame", (box.left + box.right) / 2, box.bottom + 19);
  for (const { column, name, dash } of lines) {
    pen.strokeStyle = colour(name);
    pen.lineWidth = dash ? 1.2 : 2;
    pen.setLineDash(dash ? [5, 4] : []);
    pen.lineJoin = "round";
    pen.beginPath();
    let on = false;
    samples.forEach((sample, index) => {
      if (sample.length <= column) {
        on = false;
        return;
      }
      const px = x(count - samples.length + index);
      if (on) pen.lineTo(px, y(sample[column]));
      else pen.moveTo(px, y(sample[column]));
      on = true;
    });
    pen.stroke();
  }
  pen.setLineDash([]);
}

function draw() {
  const { samples, count } = drawn;
  plot(at("torque"), samples, count, [
    { column: 1, name: "--left" },
    { column: 0, name: "--right" },
  ], 20);
  const last = samples.at(-1) || [];
  for (const wheel of [0, 1]) {
    at(`torque${wheel}`).textContent = last[wheel] ?? "–";
    at(`speed${wheel}`).textContent = last[wheel + 2] ?? "–";
  }
  const speeds = samples.some((sample) => sample.length > 2);
  at("speeds").hidden = !speeds;
  if (speeds) {
    plot(at("speed"), samples, count, [
      { column: 5, name: "--left", dash: true },
      { column: 4, name: "--right", dash: true },
      { column: 3, name: "--left" },
      { column: 2, name: "--right" },
    ], 50);
  }
}

// --- what there is to say ---------------------------------------------------------------

function state(kind, text) {
  at("state").className = `state ${kind}`;
  at("state").textContent = text;
}

function tell(now) {
  if (now.rover) state("good", `rover at ${now.rover}`);
  else state("bad", `waiting for the rover on TCP port ${now.port}; reset it if it does not come`);
  const left = now.left_out ? `, ${now.left_out} left out` : "";
  at("count").textContent = now.count || left ? `${now.count} frames${left}` : "";
  const key = now.notes.length ? String(now.notes.at(-1).number) : "";
  if (key !== shownNotes) {
    shownNotes = key;
    at("notes").replaceChildren(
      ...now.notes.slice().reverse().map((note) => {
        const item = document.createElement("li");
        const when = document.createElement("time");
        when.textContent = new Date(note.at * 1000).toLocaleTimeString([], { hour12: false });
        item.append(when, note.text);
        return item;
      }),
    );
  }
}

async function run() {
  for (;;) {
    const begun = performance.now();
    try {
      const answer = await fetch(`state?version=${version}`);
      if (!answer.ok) throw new Error(await answer.text());
      drawn = await answer.json();
      version = drawn.version;
      tell(drawn);
      draw();
    } catch (error) {
      version = -1;
      state("bad", `“uros pid” does not answer: start it again (${error.message.trim()})`);
      await new Promise((go) => setTimeout(go, 1000));
    }
    const rest = 50 - (performance.now() - begun); // twenty times a second is enough
    if (rest > 0) await new Promise((go) => setTimeout(go, rest));
  }
}

// --- sending ----------------------------------------------------------------------------

async function send(line) {
  const says = at("says");
  try {
    const answer = await fetch("gains", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ line }),
    });
    const text = await answer.text();
    const told = text.startsWith("{") ? JSON.parse(text) : { error: text };
    says.textContent = told.error ? `not sent: ${told.error}` : `sent ${told.sent}`;
    says.className = told.error ? "says bad" : "says";
    return !told.error;
  } catch {
    says.textContent = "not sent: “uros pid” does not answer";
    says.className = "says bad";
    return false;
  }
}

const fields = () => [...Array(8).keys()].map((index) => at(`g${index}`).value.trim());

at("form").onsubmit = (event) => {
  event.preventDefault();
  if (document.activeElement === at("line")) at("sendline").click();
  else send(fields().join(","));
};
at("sendline").onclick = async () => {
  const line = at("line").value.trim();
  if (!(await send(line))) return;
  line.split(",").forEach((value, index) => {
    const field = at(`g${index}`);
    if (field) field.value = index === 7 ? String(Number(value)) : value.trim();
  });
  at("line").value = "";
};
// With gains that were typed wrong it still stops.
at("stop").onclick = () => {
  const gains = fields().slice(0, 6).map((value) => (value && Number(value) >= 0 ? value : "0"));
  send([...gains, "0", "0"].join(","));
};
addEventListener("resize", () => drawn && draw());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn && draw());
run();
