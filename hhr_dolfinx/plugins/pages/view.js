"use strict";
/* View of a page: sliders, numbers, pressures along contact with their error, displacement of the mesh. */

(async () => {
  const { style, said, exactly, unit, element, prepared, colour } = drawing;
  const data = JSON.parse(document.getElementById("data").textContent);
  const arrays = hhr.decoded(data.arrays), tree = data.tree, model = await (hhr.kinds[tree.kind] ?? hhr.Model).of(tree, arrays);
  const scenery = tree.scenery, words = scenery.words, dim = scenery.dim;
  const points = arrays[scenery.points], places = arrays[scenery.contact_points], areas = arrays[scenery.areas];
  const pairs = arrays[scenery.pairs], at = (id) => document.getElementById(id);
  const units = words.units ?? {}, labels = tree.names.map((name) => name + unit(Object.hasOwn(units, name) ? units[name] : ""));
  const middle = tree.lower.map((low, k) => (low + tree.upper[k]) / 2);
  const flowing = tree.flow ? new hhr.Flow(model) : null, marching = tree.path ? new hhr.Steps(model) : null;
  const sliding = tree.friction && Object.fromEntries(["normal", "tangential", "owner", "tangents"].map((name) => [name, arrays[tree.friction[name]]]));
  const bound = tree.bound ? new hhr.Bound(model) : null;
  const past = new ways.Past(marching ? Infinity : 500); // a path without its beginning is another path
  const presses = (i) => !sliding || !sliding.tangential.includes(i);
  let point = fromAddress(), answer = null, state = null, error = null; // the last is of the answer, if it has a bound

  function fromAddress() {
    const given = new URLSearchParams(location.hash.slice(1)), wrong = [...given.keys()].filter((name) => !tree.names.includes(name));
    tree.names.forEach((name, k) => {
      const value = Number(given.get(name));
      if (given.get(name) !== null && !(value >= tree.lower[k] && value <= tree.upper[k])) wrong.push(`${name} = ${given.get(name)}`);
    });
    at("wrong").textContent = wrong.length ? `The address asks for what this page does not know: ${wrong.join(", ")}. What is shown is at the parameters below.` : "";
    return tree.names.map((name, k) => {
      const value = given.get(name) ? Number(given.get(name)) : NaN;
      return Number.isFinite(value) ? Math.min(Math.max(value, tree.lower[k]), tree.upper[k]) : middle[k];
    });
  }

  /* Parameters. */
  const controls = tree.names.map((name, k) => {
    const box = element("div", "", { className: "slider" }), label = element("label", labels[k]);
    const [low, high] = [tree.lower[k], tree.upper[k]];
    const number = element("input", "", { type: "number", min: low, max: high, step: "any" });
    const range = element("input", "", { type: "range", min: low, max: high, step: (high - low) / 1000 });
    range.setAttribute("aria-label", name);
    number.setAttribute("aria-label", `${name}, a number`);
    label.append(number);
    const ends = element("div", "", { className: "ends" });
    ends.append(element("span", said(low)), element("span", said(high)));
    box.append(label, range, ends);
    at("sliders").append(box);
    const take = (value) => {
      if (!Number.isFinite(value)) return;
      point[k] = Math.min(Math.max(value, low), high);
      at("wrong").textContent = "";
      changed();
    };
    range.addEventListener("input", () => take(Number(range.value)));
    number.addEventListener("change", () => { take(number.value === "" ? NaN : Number(number.value)); number.value = exactly(point[k]); });
    return { box, number, range };
  });

  function showParameters() {
    controls.forEach(({ box, number, range }, k) => {
      range.value = point[k];
      if (document.activeElement !== number) number.value = exactly(point[k]);
      const trained = tree.trained;
      box.classList.toggle("outside", !!trained && (point[k] < trained[0][k] || point[k] > trained[1][k]));
    });
    const now = new URLSearchParams(tree.names.map((name, k) => [name, exactly(point[k])]));
    try { history.replaceState(null, "", `#${now}`); } catch { /* some browsers forbid it for files */ }
  }

  /* Numbers. */
  // with variable shapes areas vary too, and nodal forces are known
  const axisNames = words.hypothesis === "axisymmetric" ? "rz" : "xyz"; // as the plane is called
  const what = scenery.moves ? "force of a node" : "pressure", ofPressure = (scenery.moves ? words.force : words.stress) ?? "";
  const stressOf = (force, i) => (scenery.moves ? force : areas[i] > 0 ? force / areas[i] : NaN);
  const pressure = () => Array.from(answer.forces, stressOf);
  /* Share of a contact in each condition: some are those of several contacts. */
  const common = arrays[scenery.shares], entries = [...Array(common.length / 3).keys()].map((k) => [...common.slice(3 * k, 3 * k + 3)]);
  const sharesOf = (pair) => {
    const found = Array.from(pairs, (own) => Number(own === pair));
    for (const [i] of entries) found[i] = 0;
    for (const [i, contact, share] of entries) if (contact === pair) found[i] = share;
    return found;
  };
  const ownOf = (pair) => { const shares = sharesOf(pair); return [...pairs.keys()].filter((i) => shares[i] > 0 && presses(i)); };
  const contacts = [...new Set([...pairs, ...entries.map(([, contact]) => contact)])].sort((a, b) => a - b);
  const contactName = (pair) => `contact ${pair}${words.contacts[pair] ? `: ${words.contacts[pair]}` : ""}`;

  function rows() {
    const found = [], all = pressure(), values = model.outputs(answer), slopes = marching ? [] : model.slopes(answer);
    tree.outputs.forEach((item, k) => found.push([`${item.name}${unit(item.unit)}`, values[k], slopes[k]]));
    for (const pair of contacts) {
      const own = ownOf(pair), shares = sharesOf(pair), sum = own.reduce((t, i) => t + shares[i] * answer.forces[i], 0);
      const peak = Math.max(...own.map((i) => (Number.isNaN(all[i]) ? -Infinity : all[i])));
      found.push([contactName(pair), null, null]);
      found.push([`sum of forces${unit(words.force)}`, sum, null]);
      if (Number.isFinite(peak)) found.push([`largest ${what}${unit(ofPressure)}`, peak, null]);
      found.push(["active contacts", own.filter((i) => answer.forces[i] > 0).length, null, own.length]);
      if (sliding) found.push(...rubbing(pair));
    }
    if (flowing) found.push(["largest cumulated plastic strain where the law is evaluated", Math.max(0, ...answer.cumulated), null]);
    return found;
  }

  /* Force of friction on the surface whose nodes carry the contact, along an axis, of a tangential row. */
  const onSlave = (k, axis) => -answer.forces[sliding.tangential[k]] * sliding.tangents[dim * k + axis];

  function rubbing(pair) {
    const shares = sharesOf(pair), shareOf = (k) => shares[sliding.normal[k]], contact = [...sliding.normal.keys()].filter((k) => shareOf(k) > 0);
    const total = (values) => contact.reduce((t, k) => t + shareOf(k) * values[k], 0);
    const along = [...sliding.tangential.keys()].filter((k) => contact.includes(sliding.owner[k]));
    const sums = [...Array(dim).keys()].map((c) => [`friction on the first surface, along ${axisNames[c]}${unit(words.force)}`, along.reduce((t, k) => t + shareOf(sliding.owner[k]) * onSlave(k, c), 0), null]);
    return [...sums, ["sticking contacts", contact.filter((k) => answer.statuses[k] === 1).length, null, contact.length],
      ["slipping contacts", contact.filter((k) => answer.statuses[k] === 2).length, null, contact.length],
      [`dissipated work${unit(words.work)}`, total(answer.work), null], [`largest accumulated slip${unit(words.length)}`, Math.max(0, ...contact.map((k) => answer.path[k])), null]];
  }

  function showNumbers() {
    const table = at("numbers"), head = element("tr");
    const derived = tree.outputs.length > 0 && !marching;
    head.append(element("th", ""), element("th", "value"));
    if (derived) labels.forEach((name) => head.append(element("th", `by ${name}`)));
    table.replaceChildren(head);
    if (!answer.converged) {
      table.append(element("tr", "There is no answer at these parameters.", { className: "bad" }));
      return;
    }
    at("where").textContent = `at ${tree.names.map((name, k) => `${name} = ${exactly(answer.point[k])}`).join(", ")}`;
    for (const [name, value, slopes, whole] of rows()) {
      const row = element("tr");
      if (value === null) {
        row.append(element("td", name, { className: "head", colSpan: derived ? 2 + tree.names.length : 2 }));
        table.append(row);
        continue;
      }
      row.append(element("td", name), element("td", whole === undefined ? said(value) : `${value} of ${whole}`));
      if (derived) tree.names.forEach((_, k) => row.append(element("td", slopes ? said(slopes[k]) : "")));
      table.append(row);
    }
  }

  /* An upper limit to two digits, rounded up. */
  function atMost(x) {
    const unit = 10 ** (Math.floor(Math.log10(x)) - 1);
    return x > 0 && Number.isFinite(x) ? Number((Math.ceil(x / unit * (1 - 1e-12)) * unit).toPrecision(2)) : x;
  }
  const percent = (part) => `${atMost(100 * part)} %`;
  const HOW = { bound: "a proved bound", estimate: "an estimate, not proved" };

  const worst = scenery.moves ? tree.error.forces : tree.error.pressure;
  const bounded = () => error && (scenery.moves ? error.forces : error.pressure);

  /* Errors of interpolation: of the answer itself, and the largest at random points. */
  function interpolated() {
    const own = bounded(), { kind, points: count } = tree.error;
    const [subject, whole] = scenery.moves ? ["Contact forces", "their size"] : ["Pressures", "the largest one"];
    const here = own ? `${subject} are off by at most ${said(atMost(own.error))}${unit(ofPressure)} here${own.relative < 1 ? `, ${percent(own.relative)} of ${whole}` : ", which is more than there is"}` : "";
    if (worst === null) return here ? `${here} (${HOW[kind]}).` : "Nothing is known of the errors of these answers.";
    const anywhere = `at any of ${count} random points`;
    return here ? `${here}, and by ${percent(worst)} ${anywhere} (${HOW[kind]}).` : `${subject} are off by at most ${percent(worst)} of ${whole} ${anywhere} (${HOW[kind]}).`;
  }

  const POOR = 0.05; // an indicator that nobody wants, as trained.TOLD in Python
  function aboutError() {
    const { kind } = tree.error;
    const missing = tree.missing.length ? ` Not on this page: ${tree.missing.join(", ")}.` : "";
    const known = kind === "history" ? `What flows is approximated by few modes: an indicator, not proved, says ${answer.converged ? percent(flowing.estimate(answer)) : "nothing"} of the stress for this answer.`
      : kind === "exact" ? `Exact: the finite element model itself, with all but contact eliminated.${sliding ? " Each increment slips in a straight line." : ""}` : interpolated();
    if (flowing) at("error").className = answer.converged && flowing.estimate(answer) > POOR ? "bad" : "";
    at("error").textContent = `${known} Errors of the mesh and of the model come on top.${missing}`;
  }

  /* Pressures: along the contact in the plane, on its surface in space. */
  function alongContact(own) {
    if (dim === 3) return null;
    const mean = [0, 1].map((c) => own.reduce((t, i) => t + places[i * dim + c], 0) / own.length);
    const spread = [0, 1].map((c) => own.reduce((t, i) => t + (places[i * dim + c] - mean[c]) ** 2, 0));
    const axis = spread[1] > spread[0] ? 1 : 0;
    return { axis, order: own.slice().sort((a, b) => places[a * dim + axis] - places[b * dim + axis]) };
  }

  const drawnContacts = contacts.map((pair) => {
    const canvas = element("canvas", "", { className: "plot" });
    canvas.setAttribute("role", "img");
    const legend = sliding && dim === 2 ? "; blue: traction along it; dots: orange sticks, green slips, grey is open" : "";
    at("plots").append(element("p", contactName(pair) + legend, { className: "note" }), canvas);
    const own = ownOf(pair);
    return { canvas, own, line: alongContact(own) };
  });

  /* Tangential tractions on the slave surface, by conditions; none without friction. */
  const contactOf = new Map(sliding ? Array.from(sliding.normal, (row, k) => [row, k]) : []);
  const tangentOf = new Map(sliding ? Array.from(sliding.owner, (contact, k) => [contact, k]) : []);
  const slides = (i) => sliding && answer.statuses[contactOf.get(i)] === 2;
  function tractions({ axis, order }) {
    if (!sliding) return [];
    return order.map((i) => { const k = tangentOf.get(contactOf.get(i)); return k === undefined ? 0 : stressOf(onSlave(k, axis), i); });
  }

  /* Drawn range of a contact: the active part and as much on either side, if that part is small. */
  function shown(x, order) {
    const [first, last] = [Math.min(...x), Math.max(...x)], touched = x.filter((_, k) => answer.forces[order[k]] > 0);
    const [low, high] = [Math.min(...touched), Math.max(...touched)], wide = high - low;
    return wide > 0 && 6 * wide < last - first ? [Math.max(first, low - wide), Math.min(last, high + wide)] : [first, last];
  }

  function drawLine({ canvas, line }, values) {
    const { axis, order } = line, x = order.map((i) => places[i * dim + axis]), y = order.map((i) => values[i]);
    const band = bounded()?.error ?? (worst ?? 0) * Math.max(0, ...y.filter(Number.isFinite));
    const statuses = order.map((i) => (!(answer.forces[i] > 0) ? "--open" : slides(i) ? "--slips" : "--force"));
    const titles = [`${axisNames[axis]}${unit(words.length)}`, `${what}${unit(ofPressure)}`];
    plots.line(canvas, { x, y, range: shown(x, order), band, along: tractions(line), statuses, titles });
    canvas.setAttribute("aria-label", `pressure along ${axisNames[axis]}, at most ${said(Math.max(...y))}`);
  }

  function drawMap({ canvas, own }, values) {
    const flat = arrays[scenery.flat], closed = own.map((i) => answer.forces[i] > 0);
    const most = plots.map(canvas, { places: own.map((i) => [flat[i * 2], flat[i * 2 + 1]]), values: own.map((i) => values[i]),
      closed, areas: own.map((i) => areas[i]), unit: unit(ofPressure), marks: sliding && own.map((i) => slides(i) ? "--slips" : "--force") });
    canvas.setAttribute("aria-label", `pressures on the surface, at most ${said(most)}`);
  }

  function showPressures() {
    const values = pressure();
    for (const contact of drawnContacts) (contact.line ? drawLine : drawMap)(contact, values);
  }

  /* Displacement of the mesh; not magnified if it is visible, so that bodies do not penetrate. */
  const SEEN = 0.02;
  const field = tree.field ? new Field(at("field"), { points, triangles: arrays[scenery.triangles], lines: arrays[scenery.lines], dim }) : null;
  const draws = field !== null && field.gl !== null, colours = model.colours?.() ?? []; // of the model beyond displacement and stress

  function showField() {
    const moved = draws ? model.displacement(answer) : null;
    if (!moved) return;
    if (at("exaggerate").dataset.ready === undefined) {
      const part = field.longest(moved) / field.size;
      if (part > SEEN) at("exaggerate").value = Math.min(1, part / field.most);
      at("exaggerate").dataset.ready = "";
    }
    const component = at("component").value, coloured = {};
    const further = colours.find(({ name }) => name === component);
    if (further) coloured.values = further.values(answer);
    if (component === "plastic") coloured.values = flowing.strained(answer);
    if (component === "stress") Object.assign(coloured, { values: model.stress(answer), cells: arrays[tree.stress.cells] });
    const { least, most, times } = field.show(moved, component, Number(at("exaggerate").value), coloured);
    at("times").textContent = times > 0 ? `${said(Number(times.toPrecision(2)))} times` : "not at all";
    at("least").textContent = said(least); at("most").textContent = `${said(most)}${component === "plastic" ? "" : unit(further ? further.unit : component === "stress" ? words.stress : words.length)}`;
    at("drawnby").textContent = component === "stress" ? aboutStress() : "Drawn by few modes: off by some per cent.";
    const bar = at("bar"), pen = bar.getContext("2d");
    bar.width = 256;
    for (let k = 0; k < 256; k++) { pen.fillStyle = `rgb(${colour(k / 255)})`; pen.fillRect(k, 0, 1, 14); }
  }

  function aboutStress() {
    const { cells, largest } = tree.stress.off, drawn = arrays[tree.stress.bodies].length;
    const where = flowing ? "along other histories" : sliding ? "at other increments of a path" : "at other points and corners of the box";
    const thinned = tree.strained > drawn ? ` Of ${tree.strained} cells ${drawn} are drawn, and the largest is that of these.` : "";
    return `${flowing ? "Means of cells" : "In the middle of cells"}, drawn by few modes: ${where} off by ${flowing ? "up to" : "at most"} ${percent(cells)} of the largest one${flowing ? " of a history" : ""} in any cell, and the largest one by ${percent(largest)}.${thinned}`;
  }

  const FEW = 150, REST = 200; // conditions up to which errors are bounded while a slider moves, else when it has rested, ms
  let resting = 0;

  /* Once per frame for all changes since the last one; models with a history get each of them. */
  let waiting = false, asked = [];
  function changed() {
    showParameters();
    asked.push(point.slice());
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; solve(); });
  }

  /* Increments from the current state; a change of laws restarts the path, with increments from rest. */
  function marched(next) {
    const goes = state && marching.fixed.every((k) => state.point[k] === next[k]);
    if (!goes) past.clear();
    for (answer of goes ? marching.went(state, next) : marching.begun(next)) {
      state = answer;
      past.add(answer.point, answer.converged ? rows().filter(([, value]) => value !== null) : [], answer.time);
    }
    if (!state || next.some((x, k) => state.point[k] !== x)) answer = { ...model.nothing(next), statuses: [] };
  }

  /* The last query that restarts the path: those before it are discarded. */
  function beginning() {
    const other = (next, k) => k > 0 && marching.fixed.some((axis) => next[axis] !== asked[k - 1][axis]);
    return Math.max(0, asked.findLastIndex(other));
  }

  function solve() {
    const start = performance.now();
    const points = marching && asked.length ? asked.slice(beginning()) : [point.slice()];
    asked = [];
    for (const next of points) {
      if (marching) marched(next);
      else if ((answer = model.solve(next)).converged) past.add(next, []);
    }
    error = null;
    clearTimeout(resting);
    if (bound && model.m <= FEW) error = bound.at(answer);
    else if (bound) resting = setTimeout(() => { error = bound.at(answer); aboutError(); showPressures(); }, REST);
    document.documentElement.dataset.ms = (performance.now() - start).toFixed(3);
    document.documentElement.dataset.converged = answer.converged;
    showNumbers();
    aboutError();
    showPressures();
    showField();
    showWay();
  }

  /* The path: a pad of two parameters, and with friction its history, over a parameter or the number of an increment. */
  function showWay() {
    if (at("up").options.length > 1) {
      const { pen, width, height } = prepared(at("pad"));
      ways.trace(pen, width, height, past.points, point, [Number(at("across").value), Number(at("up").value)], tree, style);
    }
    if (marching) showLoop();
  }

  function showLoop() {
    const named = past.numbers.find((numbers) => numbers.length) ?? [], chosen = at("drawn");
    if (!chosen.options.length) named.forEach(([name], k) => chosen.append(element("option", name, { value: k })));
    const axis = at("over").value, chosenNumber = Number(chosen.value);
    const kept = past.numbers.map((numbers, k) => [axis === "" ? k : past.points[k][Number(axis)], numbers[chosenNumber]?.[1]]);
    const finite = kept.filter(([, y]) => Number.isFinite(y));
    if (finite.length) plots.loop(at("loop"), finite);
  }

  function readyWay() {
    if (tree.names.length < 2 && !marching) return;
    if (marching) at("way").hidden = false;
    else at("asked").append(...at("way").querySelectorAll(":scope > .row, #pad")); // no history to show: a pad next to the sliders
    const drawn = [...labels.keys()].filter((k) => !marching?.fixed.includes(k)); // a parameter that restarts the path is not drawn
    for (const [id, first] of [["across", 0], ["up", 1]]) {
      drawn.forEach((axis, k) => at(id).append(element("option", labels[axis], { value: axis, selected: k === first })));
      at(id).addEventListener("input", showWay);
    }
    if (drawn.length < 2) for (const id of ["pad", "across", "up"]) (at(id).closest("label") ?? at(id)).hidden = true;
    ways.pad(at("pad"), { across: at("across"), up: at("up"), lower: tree.lower, upper: tree.upper, point: () => point,
      moved: (next) => { point = next; at("wrong").textContent = ""; changed(); } });
    at("memory").textContent = marching ? `What has ${[sliding && "slipped", flowing && "flowed", !sliding && !flowing && "changed in contacts"].filter(Boolean).join(" and ")} is remembered: each move goes on from where the path is${flowing ? ", in increments of a fortieth of the box" : ""}. An address, and laws that change, begin anew, loaded in proportion.` : "";
    if (!marching) return;
    for (const id of ["past", "anew", "keep"]) at(id).hidden = false;
    at("over").append(element("option", "increments", { value: "" }));
    labels.forEach((name, k) => at("over").append(element("option", name, { value: k })));
    if (drawn.length === 1) at("over").value = drawn[0];
    for (const id of ["over", "drawn"]) at(id).addEventListener("input", showWay);
    at("anew").addEventListener("click", () => { state = null; changed(); });
    if (marching.rated) readyPace();
    at("keep").addEventListener("click", () => copied(past.table(tree.names)));
  }

  /* The duration of moves, where laws depend on it. */
  function readyPace() {
    for (const id of ["pace", "hold"]) at(id).hidden = false;
    at("seconds").addEventListener("change", () => {
      if (Number(at("seconds").value) > 0) marching.seconds = Number(at("seconds").value);
      at("seconds").value = marching.seconds;
    });
    at("hold").addEventListener("click", () => changed());
  }

  async function copied(text) {
    try { await navigator.clipboard.writeText(text); at("said").textContent = "copied"; }
    catch { at("said").replaceChildren("this browser copies nothing, so select it: ", element("textarea", text, { readOnly: true, rows: 4 })); }
  }

  /* Fixed texts. */
  at("about").textContent = [words.hypothesis, `${model.m} contact conditions`, `made ${tree.made}`].join(" · ");
  at("footer").replaceChildren(...words.bodies.map((line) => element("p", `body ${line}`)),
    element("p", "This page holds the whole model and asks nobody. Scripts of hhr_dolfinx, licence of the package."));
  const names = ["length", ...axisNames.slice(0, dim)];
  names.forEach((name, k) => at("component").append(element("option", k ? `along ${name}` : "magnitude", { value: k ? k - 1 : "length" })));
  if (tree.stress) at("component").append(element("option", "von Mises' stress", { value: "stress" }));
  for (const { name } of colours) at("component").append(element("option", name, { value: name }));
  if (flowing) at("component").append(element("option", "cumulated plastic strain", { value: "plastic" }));
  if (!draws) at("shape").replaceChildren(element("h2", "Displacement"), element("p", tree.field
    ? "This browser draws no triangles (WebGL is switched off)." : "No picture: the model has no displacement, or the few modes that a page has room for do not draw it well.", { className: "note" }));
  else { at("shape").append(element("p", "", { className: "note", id: "drawnby" })); field.turning(showField); for (const id of ["component", "exaggerate"]) at(id).addEventListener("input", showField); }
  at("reset").addEventListener("click", () => { point = middle.slice(); changed(); });
  at("copy").addEventListener("click", async () => {
    const text = [...tree.names.map((name, k) => [name, point[k]]), ...rows().map(([name, value]) => [name, value ?? ""])].map((row) => row.join("\t")).join("\n");
    await copied(text);
  });
  window.addEventListener("hashchange", () => { point = fromAddress(); state = null; changed(); });
  window.addEventListener("resize", () => answer && (showPressures(), showField(), showWay()));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => answer && (showPressures(), showWay()));
  readyWay();
  showParameters();
  solve();
  window.page = { model, tree, marching, past, at: (values) => { point = values; changed(); } };
})().catch((error) => {
  document.getElementById("wrong").textContent = `This browser computes nothing of this page: ${error.message}`;
  throw error;
});
