"use strict";
/* Bound of the error of contact forces for interpolated S, as in plugins.moduli.varying_bound in Python, with the same
   notation. Forces solve the contact problem with S, so there is no other error. */

hhr.Bound = class {
  constructor(model) {
    this.model = model;
    const { areas, least, inexact, work } = model.tree.bound;
    this.areas = areas ? model.arrays[areas] : null; // with variable shapes, nodal forces have a bound and pressures have none
    Object.assign(this, { least, inexact, work: work.map((name) => model.arrays[name]) });
  }

  /* Largest errors of a nodal force and a pressure, absolute and relative to the exact ones; null if S has no factor. */
  at(answer) {
    if (!answer.converged) return null;
    const { inexact } = this, contact = this.model.contact(answer.point), amplified = this.amplified(contact.schur);
    if (!amplified) return null;
    const forces = answer.forces, better = forces.map((x) => Math.max(x, 0)), off = forces.map((x, i) => x - better[i]);
    const energy = (values) => Math.sqrt(Math.max(hhr.dot(values, this.pushed(contact.schur, values)), 0));
    const nearer = amplified.longest * this.left(contact, better, off.some((x) => x !== 0)), sizes = energy(better), apart = energy(off);
    const noise = inexact * (2 * sizes + apart + this.balanced(answer.point, contact, better)), wider = 1 + 2 * inexact;
    const further = (nearer + noise) * wider ** 2;
    const bounded = (factor, own, size, least) => {
      const error = factor * further + own;
      return { error, relative: error === 0 ? 0 : error / Math.max(size - factor * further, least) };
    };
    const peak = (values) => values.reduce((most, x, i) => (this.areas[i] > 0 ? Math.max(most, Math.abs(x) / this.areas[i]) : most), 0);
    return { forces: bounded(amplified.longest, Math.sqrt(hhr.dot(off, off)), Math.sqrt(hhr.dot(better, better)), this.least[1]),
      pressure: this.areas && bounded(amplified.most, peak(off), peak(better), this.least[2]) };
  }

  pushed(schur, forces) {
    const m = this.model.m;
    return forces.map((_, i) => forces.reduce((sum, x, j) => sum + schur[i * m + j] * x, 0));
  }

  /* |r|: the slack, if there is a force and the gap is not closed, or if it is negative. */
  left({ schur, slack }, forces, cut) {
    const moved = this.pushed(schur, forces);
    return Math.sqrt(forces.reduce((sum, x, i) => {
      const own = slack[i] + moved[i];
      return own < 0 && !(x > 0) || (x > 0 && cut) ? sum + own ** 2 : sum;
    }, 0));
  }

  /* Energy norm of the field in equilibrium with forces: (f^T K^-1 f)^1/2, f = loads θ - B^T λ. */
  balanced(point, { schur, slack, theta, opened }, forces) {
    const { model } = this;
    let driven = 0;
    model.tree.parts.forEach((part, number) => {
      const along = model.along(number, point), work = this.work[number], root = Math.sqrt(model.compliance(part, point));
      const T = model.arrays[part.terms].length, size = (T * (T + 1)) / 2;
      // the load of a lift L is -K L, and K scales with the inverse factor of K^-1
      const weights = Array.from(model.arrays[part.terms], (term, t) => theta[term] * (t < part.forced ? root : -1 / root));
      along.forEach((share, k) => {
        for (let i = 0, place = k * size; i < T; i++) for (let j = 0; j <= i; j++, place++) {
          if (weights[i] !== 0 && weights[j] !== 0) driven += (i === j ? 1 : 2) * share * weights[i] * weights[j] * work[place];
        }
      });
    });
    const pulled = forces.reduce((sum, x, i) => sum + (opened[i] - slack[i]) * x, 0);
    return Math.sqrt(Math.max(driven - 2 * pulled + hhr.dot(forces, this.pushed(schur, forces)), 0));
  }

  /* Largest Euclidean norm and pressure of forces with S norm 1, from the inverse of the factor of S. */
  amplified(schur) {
    const m = this.model.m, lower = Float64Array.from(schur);
    for (let j = 0; j < m; j++) {
      for (let i = j; i < m; i++) {
        let sum = lower[i * m + j];
        for (let k = 0; k < j; k++) sum -= lower[i * m + k] * lower[j * m + k];
        if (i === j && !(sum > 0)) return null;
        lower[i * m + j] = i === j ? Math.sqrt(sum) : sum / lower[j * m + j];
      }
    }
    const squares = new Float64Array(m), columns = new Float64Array(m), rows = new Float64Array(m), x = new Float64Array(m);
    for (let j = 0; j < m; j++) {
      for (let i = j; i < m; i++) {
        let sum = i === j ? 1 : 0;
        for (let k = j; k < i; k++) sum -= lower[i * m + k] * x[k];
        x[i] = sum / lower[i * m + i];
        const size = Math.abs(x[i]);
        squares[j] += size ** 2; columns[j] += size; rows[i] += size;
      }
    }
    const all = squares.reduce((a, b) => a + b, 0), longest = Math.sqrt(Math.min(Math.max(...columns) * Math.max(...rows), all));
    const most = this.areas && squares.reduce((found, own, i) => (this.areas[i] > 0 ? Math.max(found, Math.sqrt(own) / this.areas[i]) : found), 0);
    return { longest, most };
  }
};
