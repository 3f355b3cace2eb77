"use strict";
// Asks for what is new, again and again: a slow browser just sees fewer pictures.

const at = (id) => document.getElementById(id);
const canvas = at("picture");
let version = -1;
let picture = -1;
let paused = false;
let last = null; // the file that is shown, and its name
let own = ""; // what this browser has to say of it

function state(kind, text) {
  at("state").className = `state ${kind}`;
  at("state").textContent = text;
}

function size(octets) {
  return octets < 10000 ? `${octets} octets` : `${(octets / 1000).toFixed(1)} kB`;
}

async function show(blob, about) {
  const image = await createImageBitmap(blob);
  const dense = window.devicePixelRatio || 1;
  canvas.width = image.width;
  canvas.height = image.height;
  // Small pictures twice as large, and none higher than the window.
  const wide = Math.min(Math.max(image.width, 640), 1100);
  const high = Math.max(160, window.innerHeight - 300);
  const scale = Math.min(wide / image.width, high / image.height);
  canvas.style.width = `${Math.round(image.width * scale)}px`;
  canvas.style.imageRendering = scale * dense >= 3 ? "pixelated" : "auto";
  canvas.getContext("2d").drawImage(image, 0, 0);
  image.close();
  const topic = about.topic.replace(/^\//, "").replaceAll("/", "_");
  last = { blob, name: `${topic}_${about.stamp}${about.suffix}` };
  at("save").disabled = false;
}

function tell(about) {
  at("topic").textContent = about.topic;
  document.title = `${about.topic} – uros image view`;
  at("count").textContent = about.picture;
  at("broken").textContent = about.broken;
  at("rate").textContent = about.rate ? `${about.rate.toFixed(about.rate < 10 ? 2 : 1)} Hz` : "–";
  const has = about.width !== undefined;
  if (has) {
    at("size").textContent = `${about.width}×${about.height}, ${size(about.octets)}`;
    at("was").textContent = about.was;
    at("age").textContent = about.age;
    at("ago").textContent = about.ago < 1 ? "just now" : `${about.ago.toFixed(0)} s ago`;
    at("frame_id").textContent = about.frame_id || "none";
  }
  const stale = has && about.ago > 3;
  at("frame").classList.toggle("stale", stale);
  let said = about.trouble || own;
  if (!said && stale) said = `no picture for ${about.ago.toFixed(0)} s`;
  if (!said && !has) said = "somebody publishes; no picture has come yet";
  at("says").textContent = said;
  at("says").className = said ? "says bad" : "says";
  if (paused) state("", "paused");
  else if (said) state("bad", has ? "something is wrong" : "waiting");
  else state("good", "live");
}

async function run() {
  for (;;) {
    try {
      const answer = await fetch(`picture?version=${version}&picture=${picture}`);
      if (!answer.ok) throw new Error(await answer.text());
      const about = JSON.parse(answer.headers.get("X-About"));
      const blob = await answer.blob();
      version = about.version;
      picture = about.picture;
      if (blob.size && !paused) {
        try {
          await show(blob, about);
          own = "";
        } catch {
          own = "this browser cannot unpack the picture: it is broken within";
        }
      }
      tell(about);
    } catch (error) {
      version = picture = -1;
      state("bad", "ended");
      at("says").textContent = `“uros image view” does not answer: start it again (${error.message.trim()})`;
      at("says").className = "says bad";
      at("frame").classList.add("stale");
      await new Promise((go) => setTimeout(go, 1000));
    }
  }
}

at("pause").onclick = () => {
  paused = !paused;
  at("pause").textContent = paused ? "Go on" : "Pause";
};
at("save").onclick = () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(last.blob);
  link.download = last.name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
};
canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
run();
