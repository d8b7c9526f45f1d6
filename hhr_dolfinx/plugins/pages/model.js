"use strict";
/* The numbers of a page: amplitudes, S and the free slack at a point, contact by an active set, outputs, derivatives.

   The same as models.condensed in Python, to round-off; pages/arrays.py describes the arrays. Runs in a browser and in
   node. */

const hhr = (() => {
  const KINDS = { "<f8": Float64Array, "<f4": Float32Array, "<i4": Int32Array, "<i2": Int16Array, "<i1": Int8Array, "<u1": Uint8Array, "<u2": Uint16Array,
    "<u4": Uint32Array };
  const TOLERANCE = 1e-11, ROUND_OFF = 1e-15, MOST = 1000, STEP = 1e-5;

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

  function formula(steps, point) {
    const stack = [];
    for (const step of steps) {
      if (typeof step === "number") stack.push(step);
      else if (step in ONE) stack.push(ONE[step](stack.pop()));
      else if (step in TWO) { const b = stack.pop(); stack.push(TWO[step](stack.pop(), b)); }
      else if (step[0] === "p") stack.push(point[step[1]]);
      else stack.push(table(stack.splice(stack.length - step[1])));
    }
    return stack[0];
  }

  /* A pressure up to a parameter, see amplitudes.Coverage. */
  function coverage(item, line, point, out, first) {
    const degree = item.degree, edges = (line.length - 1) / degree, end = point[item.extent];
    let edge = 0;
    while (edge < edges - 1 && line[degree * (edge + 1)] < end) edge++;
    const start = line[degree * edge], length = line[degree * (edge + 1)] - start;
    const s = Math.min(Math.max((end - start) / length, 0), 1);
    let size = item.constant;
    item.slopes.forEach((slope, k) => { size += slope * point[k]; });
    out[first + edge] = size;
    const cube = (2 * s * s * s) / 3;
    const parts = degree === 1 ? [s - (s * s) / 2, (s * s) / 2]
      : [s - 1.5 * s * s + cube, 2 * s * s - 2 * cube, cube - (s * s) / 2];
    parts.forEach((part, k) => { out[first + edges + degree * edge + k] = size * length * part; });
    return edges + line.length;
  }

  /* LU with the largest pivots, in place; false if singular. */
  function factor(a, n, pivots) {
    for (let k = 0; k < n; k++) {
      let best = k;
      for (let i = k + 1; i < n; i++) if (Math.abs(a[i * n + k]) > Math.abs(a[best * n + k])) best = i;
      pivots[k] = best;
      const pivot = a[best * n + k];
      if (!(Math.abs(pivot) > 0)) return false;
      if (best !== k) for (let j = 0; j < n; j++) {
        const swap = a[k * n + j]; a[k * n + j] = a[best * n + j]; a[best * n + j] = swap;
      }
      for (let i = k + 1; i < n; i++) {
        const share = (a[i * n + k] /= pivot);
        if (share !== 0) for (let j = k + 1; j < n; j++) a[i * n + j] -= share * a[k * n + j];
      }
    }
    return true;
  }

  function solved(a, n, pivots, x) {
    for (let k = 0; k < n; k++) {
      const swap = x[pivots[k]]; x[pivots[k]] = x[k]; x[k] = swap;
    }
    for (let i = 0; i < n; i++) for (let j = 0; j < i; j++) x[i] -= a[i * n + j] * x[j];
    for (let i = n - 1; i >= 0; i--) {
      for (let j = i + 1; j < n; j++) x[i] -= a[i * n + j] * x[j];
      x[i] /= a[i * n + i];
    }
    return x;
  }

  function dot(one, other) {
    return one.reduce((sum, x, k) => sum + x * other[k], 0);
  }

  class Model {
    constructor(tree, arrays) {
      this.tree = tree;
      this.arrays = arrays;
      this.m = tree.m;
      this.groups = tree.groups ? arrays[tree.groups] : null;
      this.terms = arrays[tree.amplitudes.constant].length + tree.amplitudes.others
        .map((item) => item.kind === "formula" ? 1
          : (arrays[item.positions].length - 1) / item.degree + arrays[item.positions].length)
        .reduce((a, b) => a + b, 0);
      this.constantSchur = tree.schur ? this.whole(arrays[tree.schur]) : null;
      this.last = null;
      this.floating = null;
    }

    /* A symmetric matrix from its lower half by rows. */
    whole(half, m = this.m) {
      const found = new Float64Array(m * m);
      for (let i = 0, k = 0; i < m; i++) for (let j = 0; j <= i; j++, k++) found[i * m + j] = found[j * m + i] = half[k];
      return found;
    }

    theta(point) {
      const { constant, slopes, others } = this.tree.amplitudes, first = this.arrays[constant];
      const slope = this.arrays[slopes], p = point.length, found = new Float64Array(this.terms);
      for (let t = 0; t < first.length; t++) {
        found[t] = first[t];
        for (let k = 0; k < p; k++) found[t] += slope[t * p + k] * point[k];
      }
      let place = first.length;
      for (const item of others) {
        if (item.kind === "formula") found[place++] = formula(item.steps, point);
        else place += coverage(item, this.arrays[item.positions], point, found, place);
      }
      return found;
    }

    /* Components of an interpolation along its modes. */
    along(part, point) {
      const levels = this.arrays[part.levels], weights = this.arrays[part.weights], d = part.axes.length;
      const n = levels.shape[0], r = weights.shape[0], nodes = part.nodes;
      const tables = part.axes.map((axis, a) => {
        const x = (2 * (point[axis] - part.lower[a])) / (part.upper[a] - part.lower[a]) - 1, values = [1];
        for (let k = 0; k + 1 < nodes.length; k++) values.push(values[k] * (x - nodes[k]));
        return values.map((value, k) => nodes.slice(0, k).reduce((v, z) => v / (nodes[k] - z), value));
      });
      const found = new Float64Array(r);
      for (let j = 0; j < n; j++) {
        let h = 1;
        for (let a = 0; a < d; a++) h *= tables[a][levels[j * d + a]];
        for (let i = 0; i < r; i++) found[i] += weights[i * n + j] * h;
      }
      return found;
    }

    /* S, (m, m), the free slack, and the gaps of undeformed bodies, (m,) each, at a point. */
    /* True if the elastic constants are admissible at a point: interpolation does not evaluate them. */
    possible(point) {
      return this.tree.limits.every(({ steps, low, high }) => {
        const value = formula(steps, point);
        return value > low && value < (high ?? Infinity);
      });
    }

    contact(point) {
      const theta = this.theta(point), m = this.m, T = this.terms, slack = new Float64Array(m);
      if (!this.possible(point)) theta.fill(NaN); // there are no statuses for a slack that is not a number
      if (this.constantSchur) {
        const free = this.arrays[this.tree.free_slack];
        for (let i = 0; i < m; i++) for (let t = 0; t < T; t++) slack[i] += free[i * T + t] * theta[t];
        return { schur: this.constantSchur, slack, theta, driving: this.floating?.driven(theta) };
      }
      let gaps = this.arrays[this.tree.gaps];
      if (this.tree.reshaped) {
        const along = this.along(this.tree.reshaped, point), modes = this.arrays[this.tree.reshaped.modes];
        gaps = new Float64Array(m * T);
        along.forEach((a, k) => { for (let i = 0; i < m * T; i++) gaps[i] += a * modes[k * m * T + i]; });
      }
      for (let i = 0; i < m; i++) for (let t = 0; t < T; t++) slack[i] += gaps[i * T + t] * theta[t];
      const schur = new Float64Array(m * m), opened = slack.slice();
      for (const part of this.tree.parts) this.add(part, point, theta, schur, slack);
      return { schur, slack, theta, opened };
    }

    compliance(part, point) {
      return part.factor ? 1 / formula(part.factor, point) : 1;
    }

    /* Add one connected component to S and to the free slack. */
    add(part, point, theta, schur, slack) {
      const along = this.along(part, point), modes = this.arrays[part.modes], own = this.arrays[part.conditions];
      const m = this.m, c = own.length, half = (c * (c + 1)) / 2, r = along.length, columns = this.arrays[part.columns];
      const compliance = this.compliance(part, point);
      const sum = new Float64Array(half);
      for (let k = 0; k < r; k++) for (let i = 0; i < half; i++) sum[i] += compliance * along[k] * modes[k * half + i];
      for (let i = 0, k = 0; i < c; i++) for (let j = 0; j <= i; j++, k++) {
        schur[own[i] * m + own[j]] += sum[k];
        if (i !== j) schur[own[j] * m + own[i]] += sum[k];
      }
      this.arrays[part.terms].forEach((term, t) => {
        const weight = theta[term] * (t < part.forced ? compliance : -1);
        if (weight !== 0) for (let i = 0; i < c; i++) {
          let moved = 0;
          for (let k = 0; k < r; k++) moved += columns[(t * c + i) * r + k] * along[k];
          slack[own[i]] -= weight * moved;
        }
      });
    }

    /* Forces and slack for given statuses; null if their set is singular. */
    equalities(contact, active) {
      if (contact.driving) return this.floating.equalities(contact, active);
      const { schur, slack } = contact;
      const m = this.m, index = [];
      for (let i = 0; i < m; i++) if (active[i]) index.push(i);
      const n = index.length, forces = new Float64Array(m), left = Float64Array.from(slack);
      if (!n) return { forces, left };
      const a = new Float64Array(n * n), pivots = new Int32Array(n), x = new Float64Array(n);
      for (let i = 0; i < n; i++) {
        x[i] = -slack[index[i]];
        for (let j = 0; j < n; j++) a[i * n + j] = schur[index[i] * m + index[j]];
      }
      if (!factor(a, n, pivots)) return null;
      solved(a, n, pivots, x);
      for (let i = 0; i < n; i++) forces[index[i]] = x[i];
      for (let i = 0; i < m; i++) for (let j = 0; j < n; j++) left[i] += schur[i * m + index[j]] * x[j];
      for (const i of index) left[i] = 0;
      return { forces, left };
    }

    /* Conditions that pull or penetrate by more than round-off of their contact. */
    wrong(forces, left, slack) {
      const group = (i) => (this.groups ? this.groups[i] : 0), force = {}, size = {};
      let most = 0, closing = 0;
      for (let i = 0; i < this.m; i++) {
        const g = group(i);
        force[g] = Math.max(force[g] ?? -Infinity, forces[i]);
        size[g] = Math.max(size[g] ?? 0, Math.abs(slack[i]));
        most = Math.max(most, forces[i]);
        closing = Math.max(closing, -slack[i]);
      }
      const found = [], several = Object.keys(force).length > 1;
      for (let i = 0; i < this.m; i++) {
        const pulling = TOLERANCE * force[group(i)] + (several ? ROUND_OFF * most : 0);
        const through = TOLERANCE * size[group(i)] + (several ? ROUND_OFF * closing : 0);
        if (forces[i] < -pulling || left[i] < -through) found.push(i);
      }
      return found;
    }

    /* The answer at a point; initial statuses are those of the last answer. */
    solve(point, start = this.floating ? this.floating.first() : this.last) {
      const contact = this.contact(point), found = (this.floating ?? this).touched(contact, start);
      this.last = found && found.active;
      return found ? { point, contact, theta: contact.theta, converged: true, ...found } : this.nothing(point);
    }

    /* Active set: all wrong statuses at once, or, if sets repeat, the first wrong one alone (Murty 1974). */
    touched(contact, start) {
      if (!contact.slack.every(Number.isFinite)) return null;
      let active = start ? Uint8Array.from(start) : Uint8Array.from(contact.slack, (s) => (s < 0 ? 1 : 0)), one = false;
      const seen = new Set();
      for (let iteration = 1; iteration <= MOST; iteration++) {
        const found = this.equalities(contact, active);
        if (!found) {
          if (one) return null;
          one = true;
          active = new Uint8Array(this.m);
          seen.clear();
          continue;
        }
        const wrong = this.wrong(found.forces, found.left, contact.slack);
        if (!wrong.length) {
          if (!found.forces.every(Number.isFinite)) return null;
          return { active, forces: found.forces, slack: found.left, motions: found.motions, iterations: iteration };
        }
        const key = active.join("");
        if (seen.has(key)) {
          if (one) return null;
          one = true;
          seen.clear();
        }
        seen.add(key);
        active = Uint8Array.from(active);
        for (const i of one ? wrong.slice(0, 1) : wrong) active[i] ^= 1;
      }
      return null;
    }

    nothing(point) {
      this.last = null;
      const nan = new Float64Array(this.m).fill(NaN);
      return { point, active: new Uint8Array(this.m), forces: nan, slack: nan, theta: this.theta(point), converged: false };
    }

    outputs(answer) {
      return this.tree.outputs.map((item) => (answer.converged ? this.output(item, answer) : NaN));
    }

    output(item, answer) {
      const { forces, theta, motions } = answer;
      if (item.kind === "linear") {
        const [pushed, loaded] = [dot(this.arrays[item.forces], forces), dot(this.arrays[item.terms], theta)];
        return pushed + loaded + (item.motions ? dot(this.arrays[item.motions], motions) : 0) + (item.moved ? this.flow.along(item.moved, answer)[0] : 0);
      }
      if (item.kind === "quadratic") { // second derivatives along forces and θ, their lower half by rows
        const half = this.arrays[item.half], along = [...forces, ...theta];
        return along.reduce((sum, x, i) => {
          const first = i * (i + 1) / 2;
          let slope = half[first + i] * x / 2;
          for (let j = 0; j < i; j++) slope += half[first + j] * along[j];
          return sum + slope * x;
        }, 0);
      }
      const places = this.arrays[item.conditions], areas = this.arrays[item.areas], counted = this.arrays[item.counted];
      let most = -Infinity;
      places.forEach((place, k) => { most = Math.max(most, forces[place] / areas[k]); });
      if (item.kind === "largest") return most;
      let loaded = 0;
      places.forEach((place, k) => { if (most > 0 && forces[place] / areas[k] > item.least * most) loaded += counted[k]; });
      return item.offset + item.factor * loaded;
    }

    /* Derivatives of the outputs along the parameters at constant statuses, by central differences: (outputs, P). */
    slopes(answer) {
      const { lower, upper } = this.tree, found = this.tree.outputs.map(() => []);
      lower.forEach((low, axis) => {
        const step = STEP * (upper[axis] - low), here = answer.point[axis]; // no step leaves the box
        const places = [Math.max(low, here - step), Math.min(upper[axis], here + step)];
        const ends = places.map((place) => {
          const point = answer.point.slice();
          point[axis] = place;
          const contact = this.contact(point), there = this.equalities(contact, answer.active) ?? this.floating?.near(contact, answer);
          if (!there || !there.forces.every(Number.isFinite)) return null;
          return this.outputs({ converged: true, forces: there.forces, theta: contact.theta, motions: there.motions });
        });
        const width = places[1] - places[0];
        found.forEach((row, k) => row.push(ends[0] && ends[1] ? (ends[1][k] - ends[0][k]) / width : NaN));
      });
      return found;
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

  return { decoded, Model, formula, factor, solved, dot };
})();

if (typeof module !== "undefined") module.exports = hhr;
