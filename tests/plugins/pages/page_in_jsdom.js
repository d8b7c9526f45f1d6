"use strict";
/* A page in jsdom: what it shows at first and after each act of a user, as JSON. Canvases and WebGL are recorded: jsdom
   draws nothing, and what a page would draw is what is to be looked at. Reads {page, address, acts} from standard input. */

const fs = require("fs"), { JSDOM, VirtualConsole } = require("jsdom");
const WIDE = 400, HIGH = 240;
const { page, address, acts } = JSON.parse(fs.readFileSync(0, "utf8"));
const plain = (x) => (ArrayBuffer.isView(x) ? [...x] : x);

/* A context that answers each call with a number, keeps it, and lets its attributes be set. */
function recorder(attributes, calls) {
  return new Proxy(attributes, { get: (own, name) => {
    if (name in own) return own[name];
    if (name === name.toUpperCase()) return name; // constants of WebGL by their names
    return (...given) => { calls.push([name, ...given.map(plain)]); return name === "measureText" ? { width: 7 * given[0].length } : name; };
  } });
}

/* What canvases and browsers have and jsdom has not; pictures are drawn at once. */
function prepare(window) {
  const { prototype } = window.HTMLCanvasElement;
  prototype.getContext = function (kind) { this.calls ??= []; return (this.context ??= recorder({ kind }, this.calls)); };
  prototype.setPointerCapture = () => {};
  prototype.getBoundingClientRect = () => ({ left: 0, top: 0, width: WIDE, height: HIGH });
  for (const [name, size] of [["clientWidth", WIDE], ["clientHeight", HIGH]]) Object.defineProperty(prototype, name, { value: size });
  window.matchMedia = () => ({ addEventListener() {} });
  window.requestAnimationFrame = (drawn) => drawn();
  Object.defineProperty(window.navigator, "clipboard", { value: { writeText: (text) => { window.copied = text; return Promise.resolve(); } } });
}

const errors = [], virtualConsole = new VirtualConsole();
virtualConsole.on("jsdomError", (error) => errors.push(String(error.detail ?? error)));
const { window } = new JSDOM(page, { url: `file:///page.html#${address}`, runScripts: "dangerously", beforeParse: prepare, virtualConsole });
const { document } = window, at = (id) => document.getElementById(id);

function event(kind, values = {}) {
  return Object.assign(new window.Event(kind, { bubbles: true, cancelable: true }), values);
}

/* Acts of a user: a slider, a number, a choice, a click, a key on a canvas, a pointer from one place to others. */
const ACTS = {
  slide: (name, value) => { const input = document.querySelector(`input[aria-label="${name}"]`); input.value = value; input.dispatchEvent(event("input")); },
  write: (name, value) => { const input = document.querySelector(`input[aria-label="${name}, a number"]`); input.value = value; input.dispatchEvent(event("change")); },
  choose: (id, value) => { at(id).value = value; at(id).dispatchEvent(event("input")); },
  click: (id) => at(id).click(),
  set: (id, value) => { at(id).value = value; at(id).dispatchEvent(event("change")); },
  key: (id, key) => at(id).dispatchEvent(event("keydown", { key })),
  drag: (id, ...places) => places.forEach(([x, y], k) => at(id).dispatchEvent(event(k ? "pointermove" : "pointerdown", { clientX: x, clientY: y, pointerId: 1, buttons: 1 }))),
  wheel: (id, deltaY) => at(id).dispatchEvent(event("wheel", { deltaY })),
  address: (hash) => { window.location.hash = hash; window.dispatchEvent(event("hashchange")); },
};

/* All texts by the id of their element, the table by rows, what each canvas was told since the last look, and the state. */
function seen() {
  const texts = Object.fromEntries([...document.querySelectorAll("[id]")].filter((one) => !["SCRIPT"].includes(one.tagName)).map((one) => [one.id, one.textContent]));
  const table = [...at("numbers").rows].map((row) => [...row.cells].map((cell) => cell.textContent));
  const canvases = [...document.querySelectorAll("canvas")].map((one) => ({ id: one.id, label: one.getAttribute("aria-label"), calls: (one.calls ?? []).splice(0) }));
  const inputs = [...document.querySelectorAll("#sliders input[type=range]")].map((one) => Number(one.value));
  const labels = [...document.querySelectorAll("#sliders label")].map((one) => one.textContent);
  const hidden = [...document.querySelectorAll("[id][hidden]")].map((one) => one.id);
  return { texts, table, canvases, inputs, labels, hidden, hash: window.location.hash, copied: window.copied, converged: document.documentElement.dataset.converged };
}

/* The kernel of the page is compiled in the background. */
async function acted() {
  while (!window.page && !errors.length) await new Promise((later) => setTimeout(later, 5));
  const found = [seen()];
  for (const [kind, ...given] of acts) { ACTS[kind](...given); found.push(seen()); }
  process.stdout.write(JSON.stringify({ found, errors }), () => process.exit()); // not before all of it is written
}
acted();
