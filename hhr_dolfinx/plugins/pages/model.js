"use strict";
/* The numbers of a page: a kernel in WebAssembly, its answers, and what a page draws of them.

   Answers are those of models.condensed in Python, to round-off; pages/arrays.py and layout.py describe the data. Runs in a
   browser and in node. */

const hhr = (() => {
  const KINDS = { "<f8": Float64Array, "<f4": Float32Array, "<i4": Int32Array, "<i2": Int16Array, "<i1": Int8Array, "<u1": Uint8Array, "<u2": Uint16Array,
    "<u4": Uint32Array };
  const STEP = 1e-5;

  function decoded(arrays) {
    const found = {};
    for (const [name, item] of Object.entries(arrays)) {
      const text = atob(item.data), bytes = new Uint8Array(text.length);
      for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
      found[name] = new KINDS[item.kind](bytes.buffer);
      found[name].shape = item.shape;
    }
    return found;
  }

  /* Formulas: operations on a stack, see arrays.steps_of. */
  const ONE = { sqrt: Math.sqrt, exp: Math.exp, log: Math.log, sin: Math.sin, cos: Math.cos, tan: Math.tan,
    tanh: Math.tanh, abs: Math.abs, neg: (x) => -x };
  const TWO = { "+": (a, b) => a + b, "-": (a, b) => a - b, "*": (a, b) => a * b, "/": (a, b) => a / b,
    "^": (a, b) => Math.pow(a, b), min: Math.min, max: Math.max };

  function table(values) {
    const x = values[0];
    for (let k = 1; k + 3 < values.length; k += 2) {
      const [a, b] = [values[k], values[k + 2]];
      if (x >= a && x <= b) return values[k + 1] + ((values[k + 3] - values[k + 1]) * (x - a)) / (b - a);
    }
    return NaN;
  }

  function functionOf(steps) {
    const stack = [];
    for (const step of steps) {
      if (typeof step === "number") stack.push(() => step);
      else if (step in ONE) { const f = ONE[step], a = stack.pop(); stack.push((p) => f(a(p))); }
      else if (step in TWO) { const f = TWO[step], b = stack.pop(), a = stack.pop(); stack.push((p) => f(a(p), b(p))); }
      else if (step[0] === "p") { const k = step[1]; stack.push((p) => p[k]); }
      else { const all = stack.splice(stack.length - step[1]); stack.push((p) => table(all.map((f) => f(p)))); }
    }
    return stack[0];
  }

  const functions = new WeakMap();
  function formula(steps, point) {
    if (!functions.has(steps)) functions.set(steps, functionOf(steps));
    return functions.get(steps)(point);
  }

  function dot(one, other) {
    return one.reduce((sum, x, k) => sum + x * other[k], 0);
  }

  /* The kernel of the C headers in WebAssembly, with the data of a model in its memory. */
  class Kernel {
    /* From the tree and arrays of a page; browsers compile long kernels in the background only. */
    static async of(tree, arrays) {
      const kernel = new Kernel(tree.kernel, arrays), { Math: M } = globalThis;
      const env = { ...Object.fromEntries("exp log sin cos tan asin acos atan sinh cosh tanh pow atan2 hypot".split(" ").map((name) => [name, M[name]])),
        formula: (number, at) => formula(kernel.own.formulas[number - 1], kernel.doubles(at, kernel.own.sizes.parameters + 4)),
        reached: (at) => kernel.reached(at) };
      const { instance } = await WebAssembly.instantiate(arrays[tree.kernel.code], { env });
      return kernel.filled(instance.exports);
    }

    constructor(own, arrays) {
      Object.assign(this, { own, arrays, layouts: {}, placed: new Map() });
    }

    filled(calls) {
      this.calls = calls;
      const { sizes, data } = this.own;
      this.fill("sizes", Object.values(sizes), calls.sizes());
      this.fill("data", data, calls.data());
      this.asked = calls.room(8 * (sizes.parameters + 4));
      if (!calls.ready()) throw new Error("there is no memory for this model");
      return this;
    }

    /* Offsets of the fields of a record, its size and its alignment, as compilers of C have them. */
    layout(kind) {
      if (this.layouts[kind]) return this.layouts[kind];
      let end = 0, widest = 4;
      const fields = this.own.layouts[kind].map((code) => {
        const [size, align] = code === "d" ? [8, 8] : code[0] === "r" ? [this.layout(code.slice(2)).size, this.layout(code.slice(2)).widest] : [4, 4];
        const offset = Math.ceil(end / align) * align;
        [end, widest] = [offset + size, Math.max(widest, align)];
        return { code, offset };
      });
      return (this.layouts[kind] = { fields, widest, size: Math.ceil(end / widest) * widest });
    }

    /* Writes a record at an address, with what it points to elsewhere. */
    fill(kind, values, at) {
      this.layout(kind).fields.forEach(({ code, offset }, k) => {
        const value = values[k], there = at + offset;
        if (code[0] === "r") return this.fill(code.slice(2), value, there);
        const number = code === "d" ? Number(value ?? 0) : code === "i" ? value ?? 0 : value === null ? 0 : this.placedAt(code, value);
        const view = new DataView(this.calls.memory.buffer);
        return code === "d" ? view.setFloat64(there, number, true) : view.setInt32(there, number, true);
      });
    }

    /* Address of records, or of an array by its name or by its values. */
    placedAt(code, value) {
      if (code[0] === "R") {
        const kind = code.slice(2), { size } = this.layout(kind), at = this.calls.room(size * value.length);
        value.forEach((own, k) => this.fill(kind, own, at + k * size));
        return at;
      }
      const key = code + value;
      if (typeof value === "string" && this.placed.has(key)) return this.placed.get(key);
      const numbers = typeof value === "string" ? this.arrays[value] : value, wide = code === "D" ? 8 : 4;
      const at = this.calls.room(wide * numbers.length);
      (code === "D" ? this.doubles(at, numbers.length) : new Int32Array(this.calls.memory.buffer, at, numbers.length)).set(numbers);
      this.placed.set(key, at);
      return at;
    }

    /* Numbers in the memory, which is whole from the first answer on. */
    doubles(at, count) { return new Float64Array(this.calls.memory.buffer, at, count); }

    bytes(at, count) { return new Uint8Array(this.calls.memory.buffer, at, count); }

    /* Address of a point. */
    point(point) {
      this.doubles(this.asked, point.length).set(point);
      return this.asked;
    }

    outputs() { return [...this.doubles(this.calls.outputs(), this.own.sizes.outputs)]; }

    theta(point = null) { return this.doubles(this.calls.theta(point ? this.point(point) : 0), this.own.sizes.terms).slice(); }
  }

  class Model {
    static async of(tree, arrays) { return new this(tree, arrays, await Kernel.of(tree, arrays)); }

    constructor(tree, arrays, kernel) {
      Object.assign(this, { tree, arrays, kernel, m: tree.m, terms: kernel.own.sizes.terms, last: null, statuses: null });
      this.count = kernel.own.sizes.motions;
      this.lastMotions = kernel.calls.room(8 * this.count);
    }

    /* Initial statuses of bodies that contact alone holds: answers that are not unique then depend on the point only. */
    first() {
      const { lower, upper } = this.tree;
      return (this.statuses ??= this.touched(lower.map((low, k) => (low + upper[k]) / 2), null)?.active ?? null);
    }

    /* The answer at a point; initial statuses are those of the last answer. */
    solve(point, start = this.count ? this.first() : this.last) {
      const found = this.touched(point, start);
      this.last = found && found.active;
      return found ?? this.nothing(point);
    }

    /* The same from some statuses, or without any from those of the free slack; null without an answer. */
    touched(point, start) {
      const { kernel, m } = this, { calls } = kernel;
      if (start) kernel.bytes(calls.active(), m).set(start);
      if (!calls.solve(kernel.point(point), start ? 1 : 0)) return null;
      return { point: [...point], converged: true, forces: kernel.doubles(calls.forces(), m).slice(), active: kernel.bytes(calls.active(), m).slice(),
        motions: this.count ? [...kernel.doubles(calls.motions(), this.count)] : undefined, theta: kernel.theta(), outputs: kernel.outputs() };
    }

    nothing(point) {
      this.last = null;
      const nan = new Float64Array(this.m).fill(NaN);
      return { point, active: new Uint8Array(this.m), forces: nan, theta: this.kernel.theta(point), converged: false };
    }

    /* S, (m, m), the free slack, and the gaps of undeformed bodies, (m,) each, at a point. */
    contact(point) {
      const { kernel, m } = this, { calls } = kernel;
      calls.contact(kernel.point(point));
      const schur = kernel.doubles(calls.schur(), m * m).slice(), slack = kernel.doubles(calls.slack(), m).slice();
      return { schur, slack, theta: kernel.theta(), opened: kernel.doubles(calls.opened(), m).slice() };
    }

    /* Components of the interpolation of a part along its modes. */
    along(number, point) {
      const { kernel } = this, rank = this.arrays[this.tree.parts[number].weights].shape[0];
      return kernel.doubles(kernel.calls.along(number, kernel.point(point)), rank).slice();
    }

    compliance(part, point) {
      return part.factor ? 1 / formula(part.factor, point) : 1;
    }

    outputs(answer) {
      return answer.converged ? answer.outputs : this.tree.outputs.map(() => NaN);
    }

    /* Derivatives of the outputs along the parameters at constant statuses, by central differences: (outputs, P). */
    slopes(answer) {
      const { lower, upper } = this.tree, found = this.tree.outputs.map(() => []);
      lower.forEach((low, axis) => {
        const step = STEP * (upper[axis] - low), here = answer.point[axis]; // no step leaves the box
        const places = [Math.max(low, here - step), Math.min(upper[axis], here + step)];
        const ends = places.map((place) => this.again(answer, answer.point.map((x, k) => (k === axis ? place : x))));
        const width = places[1] - places[0];
        found.forEach((row, k) => row.push(ends[0] && ends[1] ? (ends[1][k] - ends[0][k]) / width : NaN));
      });
      return found;
    }

    /* Outputs at another point for the statuses of an answer; null if they are not determined. */
    again({ active, motions, converged }, point) {
      const { kernel } = this;
      if (!converged) return null;
      kernel.bytes(kernel.calls.active(), this.m).set(active);
      if (motions) kernel.doubles(this.lastMotions, motions.length).set(motions);
      return kernel.calls.again(kernel.point(point), this.lastMotions) ? kernel.outputs() : null;
    }

    /* Displacement of the drawn nodes, node by node; null if the page has no map to it. */
    displacement(answer) {
      return this.tree.field && answer.converged ? this.drawn(this.tree.field, answer) : null;
    }

    /* Von Mises' stress of the drawn cells; null if the page has no map to it. */
    stress(answer) {
      const own = this.tree.stress;
      if (!own || !answer.converged) return null;
      const strains = this.drawn(own, answer), bodies = this.arrays[own.bodies], n = own.components; // times μ' at the middle of the box
      const moduli = own.moduli.map((pair, k) => pair.map((steps) => formula(steps, answer.point) / own.middle[k]));
      return Float32Array.from(bodies, (body, cell) => {
        const [first, second, ...shears] = strains.subarray(cell * n, (cell + 1) * n), [volume, shape] = moduli[body];
        const all = own.plane_stress ? volume * (first + second) : 0; // else they are deviators, and the third follows
        const [a, b] = [2 * shape * first + all, 2 * shape * second + all], c = own.plane_stress ? 0 : -a - b;
        const sheared = shears.reduce((sum, value) => sum + (2 * shape * value) ** 2, 0);
        return Math.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 2 + 1.5 * sheared);
      });
    }

    drawn(field, answer) {
      const modes = this.arrays[field.modes], n = modes.shape[1], found = new Float32Array(n);
      const along = field.kind === "linear" ? this.linear(field, answer) : field.kind === "fitted" ? this.fitted(field, answer)
        : field.kind === "stressed" ? this.flow.stressed(field, answer) : this.flow.along({ ...field, modes: field.modes_of_flow }, answer);
      field.scales.forEach((scale, k) => {
        for (let i = 0; i < n; i++) found[i] += scale * along[k] * modes[k * n + i];
      });
      return found;
    }

    linear(field, { theta, forces, motions }) {
      const rigid = field.motions ? this.arrays[field.motions] : [], r = motions?.length ?? 0;
      const terms = this.arrays[field.terms], pushed = this.arrays[field.forces], T = this.terms, m = this.m;
      return field.scales.map((_, k) => {
        let along = 0;
        for (let t = 0; t < T; t++) along += terms[k * T + t] * theta[t];
        for (let i = 0; i < m; i++) along += pushed[k * m + i] * forces[i];
        for (let j = 0; j < r; j++) along += rigid[k * r + j] * motions[j];
        return along;
      });
    }

    fitted(field, { point, forces }) {
      const pushes = this.arrays[field.pushes], fit = this.arrays[field.fit], [F, K, R] = fit.shape;
      const m = this.m, weights = [1];
      const scaled = field.axes.map(({ modulus, low, high }, k) => {
        const value = modulus ? 1 / formula(modulus, point) : point[k];
        return (2 * (value - low)) / (high - low) - 1;
      });
      for (let j = 0; j + 1 < R; j++) {
        let along = 0;
        for (let i = 0; i < m; i++) along += pushes[j * m + i] * forces[i];
        weights.push(along);
      }
      const found = new Float64Array(K);
      for (let f = 0; f < F; f++) {
        const feature = field.powers[f].reduce((product, power, k) => product * scaled[k] ** power, 1);
        for (let k = 0; k < K; k++) for (let r = 0; r < R; r++) found[k] += feature * fit[(f * K + k) * R + r] * weights[r];
      }
      return found;
    }
  }

  return { decoded, Kernel, Model, formula, dot, kinds: {} }; // models of plug-ins by their names
})();

if (typeof module !== "undefined") module.exports = hhr;
