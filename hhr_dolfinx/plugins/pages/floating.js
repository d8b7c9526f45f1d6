"use strict";
/* Bodies with rigid motions q as unknowns in addition to contact forces, as contact.floating in Python:

   slack = free slack + S λ - G q >= 0,  λ >= 0,  G^T λ = driving. */

hhr.Floating = class {
  static WEAKNESS = [1e3, 1e5, 1e7, 1e9]; // compliances of springs over that of the bodies, as in contact/floating.py
  static MOST_STEPS = 30;
  static SINGULAR = 1e-8;
  static ROUND_OFF = 1e-13;
  static BALANCED = 1e-12;
  static NOTHING = 1e-14;
  // compliance of springs for derivatives, if active contacts do not hold the bodies, and largest part of a load on them
  static WEAK = 1e5;
  static BORNE = 1e-3;

  constructor(model) {
    const { taken, driving } = model.tree.floating, m = model.m, mean = (values) => values.reduce((a, b) => a + b, 0) / m;
    Object.assign(this, { model, taken: model.arrays[taken], driving: model.arrays[driving], count: model.arrays[taken].shape[1] });
    this.motions = [...Array(this.count).keys()];
    this.statuses = null;
    this.size = mean(Array.from({ length: m }, (_, i) => Math.abs(model.constantSchur[i * m + i]))) || 1;
    const columns = this.motions.map((j) => Array.from({ length: m }, (_, i) => this.taken[i * this.count + j]));
    this.units = columns.map((own) => this.size / (Math.max(...own.map(Math.abs)) || 1));
    this.pushes = columns.map((own) => this.size / (mean(own.map((x) => x * x)) || 1));
    model.floating = this;
  }

  /* Loads along the motions. */
  driven(theta) {
    return this.motions.map((j) => theta.reduce((sum, x, t) => sum + this.driving[j * theta.length + t] * x, 0));
  }

  /* Residual of the balance along each motion under forces, and the size of its terms. */
  balance(forces, driving) {
    return this.motions.map((j) => {
      let left = driving[j], size = Math.abs(driving[j]);
      for (let i = 0; i < this.model.m; i++) {
        left -= forces[i] * this.taken[i * this.count + j];
        size += Math.abs(forces[i] * this.taken[i * this.count + j]);
      }
      return { left, size };
    });
  }

  balanced(sides, nothing = 0) {
    const most = Math.max(...sides.map(({ size }, j) => this.units[j] * size));
    return sides.every(({ left, size }, j) => this.units[j] * Math.abs(left)
      <= hhr.Floating.SINGULAR * this.units[j] * size + hhr.Floating.ROUND_OFF * most + this.units[j] * nothing);
  }

  /* Forces, slack and motions for given statuses; null if the active contacts do not hold all bodies. */
  equalities({ schur, slack, driving }, active) {
    const { model, count, taken, units } = this, m = model.m, index = [...active.keys()].filter((i) => active[i]);
    const n = index.length, size = n + count, a = new Float64Array(size * size), x = new Float64Array(size);
    index.forEach((row, i) => {
      x[i] = -slack[row];
      index.forEach((column, j) => { a[i * size + j] = schur[row * m + column]; });
      for (const j of this.motions) a[(n + j) * size + i] = -(a[i * size + n + j] = -taken[row * count + j] * units[j]);
    });
    for (const j of this.motions) x[n + j] = units[j] * driving[j];
    const whole = a.slice(), right = x.slice(), pivots = new Int32Array(size);
    if (!hhr.factor(a, size, pivots)) return null;
    hhr.solved(a, size, pivots, x);
    const most = Math.max(...right.map(Math.abs));
    for (let i = 0; i < size; i++) {
      const left = x.reduce((sum, value, j) => sum - whole[i * size + j] * value, right[i]);
      if (!(Math.abs(left) <= hhr.Floating.SINGULAR * most)) return null;
    }
    const forces = new Float64Array(m), motions = this.motions.map((j) => units[j] * x[n + j]);
    index.forEach((row, i) => { forces[row] = x[i]; });
    if (!this.balanced(this.balance(forces, driving))) return null;
    const left = Float64Array.from(slack, (s, i) => {
      const pushed = index.reduce((sum, column, j) => sum + schur[i * m + column] * x[j], s);
      return active[i] ? 0 : pushed - this.moved(i, motions);
    });
    return { forces, left, motions };
  }

  moved(i, motions) {
    return motions.reduce((sum, q, j) => sum + this.taken[i * this.count + j] * q, 0);
  }

  /* Contact problem without motions, for bodies on weak springs with given ends. */
  sprung({ schur, slack, driving }, weak, ends) {
    const { count, taken } = this, m = this.model.m, compliance = this.pushes.map((push) => push * weak), held = schur.slice();
    for (let i = 0; i < m; i++) for (let k = 0; k < m; k++) for (const j of this.motions) {
      held[i * m + k] += taken[i * count + j] * compliance[j] * taken[k * count + j];
    }
    const offset = ends.map((end, j) => end + compliance[j] * driving[j]);
    return { compliance, schur: held, slack: slack.map((s, i) => s - this.moved(i, offset)) };
  }

  /* Motions relative to the ends of springs, under forces. */
  drawn(ends, compliance, sides) {
    return ends.map((end, j) => end + compliance[j] * sides[j].left);
  }

  /* Forces and motions for the statuses of an answer, for derivatives: undetermined motions are minimal. */
  near(contact, { active, motions }) {
    if (!motions) return null;
    const held = this.sprung(contact, hhr.Floating.WEAK, motions), found = this.model.equalities(held, active);
    if (!found) return null;
    const sides = this.balance(found.forces, contact.driving);
    if (sides.some(({ left, size }) => Math.abs(left) > hhr.Floating.BORNE * size)) return null; // a load acts along a motion without resistance
    return { ...found, motions: this.drawn(motions, held.compliance, sides) };
  }

  /* Active set; if its sets do not hold the bodies, weak springs whose ends follow the motions. */
  touched(contact, start) {
    const direct = this.model.touched(contact, start);
    if (direct) return direct;
    const { model } = this, { slack, driving } = contact;
    // forces that close only round-off of the gaps: without loads there are no others to compare with
    const nothing = (hhr.Floating.NOTHING * slack.reduce((most, s) => Math.max(most, Math.abs(s)), 0)) / this.size;
    let active = start ?? Uint8Array.from(slack, (s) => (s < 0 ? 1 : 0)), ends = this.motions.map(() => 0);
    for (const weak of hhr.Floating.WEAKNESS) for (let step = 0; step < hhr.Floating.MOST_STEPS; step++) {
      const held = this.sprung(contact, weak, ends), found = model.touched(held, active);
      if (!found) return null;
      const sides = this.balance(found.forces, driving), most = Math.max(...sides.map(({ size }) => size));
      ends = this.drawn(ends, held.compliance, sides);
      active = found.active;
      const close = sides.every(({ left }) => Math.abs(left) <= hhr.Floating.BALANCED * most + nothing);
      if (close && this.balanced(sides, nothing)) return { ...found, motions: ends };
      const again = model.touched(contact, active);
      if (again) return again;
    }
    return null;
  }

  /* Initial statuses: answers that are not unique then depend on the point only. */
  first() {
    if (!this.statuses) {
      const { lower, upper } = this.model.tree, middle = lower.map((low, k) => (low + upper[k]) / 2);
      this.statuses = this.touched(this.model.contact(middle), null)?.active ?? null;
    }
    return this.statuses;
  }
};
