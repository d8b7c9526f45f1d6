"use strict";
/* Pictures of inelastic bodies on a page, from the states of steps.js; strains and memory are stored component by component. */

((hhr) => {
  class Flow {
    constructor(model) {
      const { flow } = model.tree, { sizes } = model.kernel.own;
      Object.assign(this, { model, flow, m: model.m, ell: sizes.modes, points: sizes.points, components: sizes.components, terms: sizes.terms });
      this.parts = model.arrays[flow.parts];
      this.groups = flow.groups.map(({ points, elastic }) => ({ points, elastic: model.arrays[elastic] }));
      this.grading = flow.groups.flatMap(({ grading, points }) => Array.from(grading ? model.arrays[grading] : { length: points }, (x) => x ?? 1)); // factor of C
      model.flow = this;
    }

    /* Rows of a displacement: of corrections, of forces and loads by part, of imposed displacements, and of loose bodies. */
    along(rows, { correction, forces, theta, gives, motions }) {
      const [modes, given, pushed, forced] = ["modes", "given", "pushed", "forced"].map((name) => this.model.arrays[rows[name]]);
      const { ell, m, terms } = this, count = modes.length / ell, found = new Float64Array(count);
      const rigid = rows.motions ? this.model.arrays[rows.motions] : [], loose = rows.motions ? motions.length : 0;
      for (let r = 0; r < count; r++) {
        for (let j = 0; j < loose; j++) found[r] += rigid[r * loose + j] * motions[j];
        for (let j = 0; j < ell; j++) found[r] += modes[r * ell + j] * correction[j];
        for (let t = 0; t < terms; t++) found[r] += given[r * terms + t] * theta[t];
        gives.forEach((c, q) => {
          let elastic = 0;
          for (let t = 0; t < terms; t++) elastic += forced[(q * count + r) * terms + t] * theta[t];
          for (let i = 0; i < m; i++) elastic -= pushed[(q * count + r) * m + i] * forces[i];
          found[r] += c * elastic;
        });
      }
      return found;
    }

    /* Coefficients of the modes of the stress: of forces and loads, and, by part, of imposed and plastic strains. */
    stressed(field, { forces, theta, gives, plastic }) {
      const [pushed, forced, given, flowed, fit] = ["pushed", "forced", "given", "plastic", "fit"].map((name) => this.model.arrays[field[name]]);
      const { m, terms, points, components } = this, count = field.scales.length, r = fit.shape[0], shares = new Float64Array(r);
      for (let a = 0; a < r; a++) for (let k = 0; k < points; k++) for (let i = 0; i < components; i++) {
        shares[a] += fit[(a * points + k) * components + i] * plastic[i * points + k];
      }
      return field.scales.map((_, mode) => {
        let along = 0;
        for (let i = 0; i < m; i++) along += pushed[mode * m + i] * forces[i];
        for (let t = 0; t < terms; t++) along += forced[mode * terms + t] * theta[t];
        gives.forEach((c, q) => {
          let own = 0;
          for (let t = 0; t < terms; t++) own += given[(q * count + mode) * terms + t] * theta[t];
          for (let a = 0; a < r; a++) own += flowed[(q * count + mode) * r + a] * shares[a];
          along += own / c;
        });
        return along;
      });
    }

    /* Stress of the leave-one-out residual of the plastic strain, over the stress at the points with laws. */
    estimate({ strain, plastic, gives }) {
      const { points, components } = this, { modes, scales, without } = this.flow.unforeseen, inner = this.model.arrays[without];
      const shown = this.model.arrays[modes], count = scales.length, shares = new Float64Array(count), at = (k, i) => plastic[i * points + k];
      for (let a = 0; a < count; a++) for (let k = 0; k < points; k++) for (let i = 0; i < components; i++) {
        shares[a] += scales[a] ** 2 * shown[(a * points + k) * components + i] * at(k, i);
      }
      let left = 0, stress = 0, place = 0;
      this.groups.forEach(({ points: own, elastic }) => {
        for (let k = place; k < place + own; k++) {
          const open = [], strains = [];
          for (let i = 0; i < components; i++) {
            let value = at(k, i);
            for (let a = 0; a < count; a++) value -= shown[(a * points + k) * components + i] * shares[a];
            open.push(value);
            strains.push(strain[i * points + k] - at(k, i));
          }
          for (let i = 0; i < components; i++) {
            let value = 0, whole = 0;
            for (let j = 0; j < components; j++) {
              value += inner[(k * components + i) * components + j] * open[j];
              whole += this.grading[k] * elastic[i * components + j] * strains[j];
            }
            left += (value / gives[this.parts[k]]) ** 2;
            stress += (whole / gives[this.parts[k]]) ** 2;
          }
        }
        place += own;
      });
      return stress > 0 ? Math.sqrt(left / stress) : 0;
    }

    /* Cumulated plastic strain of the drawn nodes; null if the page has none. */
    strained({ cumulated }) {
      const { field } = this.model.tree;
      if (!field) return null;
      const { modes, scales, fit } = field.strained, rows = this.model.arrays[modes], inside = this.model.arrays[fit];
      const n = rows.shape[1], found = new Float32Array(n);
      scales.forEach((scale, a) => {
        let share = 0;
        cumulated.forEach((p, z) => { share += scale * inside[a * this.points + z] * p; });
        for (let i = 0; i < n; i++) found[i] += share * rows[a * n + i];
      });
      return found.map((p) => Math.max(p, 0));
    }
  }

  hhr.Flow = Flow;
  if (typeof module !== "undefined") module.exports = hhr;
})(typeof module !== "undefined" ? require("./model.js") : hhr);
