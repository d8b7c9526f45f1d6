"use strict";
/* Histories of inelastic bodies: plastic corrections g and all contact forces of an increment, by Newton's method with a
   line search, as in inelastic.condensed_step in Python. The arrays are described in
   inelastic.condensed_flow; strains are stored component by component. Needs model.js. */

((hhr) => {
  const TOLERANCE = 1e-11, ROUND_OFF = 1e-14, NEWTON = 60, LEAST = 1 / 256, DECREASE = 1e-4, HALVED = 6, QUICK = 0.1;
  const MOST = 1, ALONE = 0.01, RUNAWAY = 100; // limits of small strains, see models.strains
  const STEPS = 40; // increments from one end of a parameter's range to the other
  const norm = (values) => Math.sqrt(values.reduce((t, x) => t + x * x, 0));

  class Flowing {
    constructor(model) {
      const { flow } = model.tree, own = (name) => model.arrays[flow[name]];
      Object.assign(this, { model, flow, m: model.m, fixed: flow.fixed, moduli: null, tangent: null });
      for (const name of ["per_mode", "per_force", "forced", "given", "moved", "modal", "coupled", "pressed", "gaps", "parts", "mode_parts"]) this[name] = own(name);
      this.ell = this.per_mode.shape[0];
      this.points = this.parts.length;
      this.size = this.per_mode.shape[1];
      this.components = this.size / this.points;
      this.terms = this.gaps.shape[1];
      this.tested = this.testedBy(own("weights"));
      this.weight = norm(this.tested);
      const halves = own("schur"), count = halves.shape[0], half = halves.length / count;
      this.schurs = Array.from({ length: count }, (_, q) => model.whole(halves.subarray(q * half, (q + 1) * half)));
      model.flow = this;
    }

    /* Weights times 2 mu times the deviator of the strain of each mode. */
    testedBy(weights) {
      const { ell, size, points, components } = this, found = new Float64Array(ell * size);
      for (let j = 0; j < ell; j++) for (let k = 0; k < points; k++) {
        const at = (i) => j * size + i * points + k, mean = (this.per_mode[at(0)] + this.per_mode[at(1)] + this.per_mode[at(2)]) / 3;
        for (let i = 0; i < components; i++) found[at(i)] = weights[k] * (this.per_mode[at(i)] - (i < 3 ? mean : 0));
      }
      return found;
    }

    /* Elasticity at a point; moduli do not change within a history. */
    elasticity(point) {
      const values = this.flow.moduli.map((steps) => hhr.formula(steps, point)), key = values.join();
      if (this.moduli?.key === key) return this.moduli;
      const gives = values.length ? values.map((value, q) => this.flow.middle[q] / value) : [1], { m, points } = this;
      const schur = new Float64Array(m * m);
      gives.forEach((c, q) => { for (let i = 0; i < m * m; i++) schur[i] += c * this.schurs[q][i]; });
      const scale = Float64Array.from({ length: points }, (_, k) => gives[this.parts[k]]);
      const coupled = this.coupled.map((x, k) => x * gives[this.mode_parts[Math.floor(k / m)]]);
      return (this.moduli = { key, gives, schur, scale, coupled });
    }

    /* Shear modulus and constants of the law of each point; null if they are invalid for a body. */
    laws(point) {
      const found = { shear: new Float64Array(this.points), yields: new Float64Array(this.points).fill(Infinity), hardens: new Float64Array(this.points) };
      let place = 0;
      for (const { points, young, poisson, law } of this.flow.groups) {
        const shear = hhr.formula(young, point) / (2 * (1 + poisson)), constants = law && law.map((steps) => hhr.formula(steps, point));
        if (!(shear > 0) || (law && !(constants[0] > 0 && constants[1] >= 0))) return null;
        found.shear.fill(shear, place, place + points);
        if (law) { found.yields.fill(constants[0], place, place + points); found.hardens.fill(constants[1], place, place + points); }
        place += points;
      }
      return found;
    }

    /* Undeformed bodies at a point, without plastic strain. */
    rest(point) {
      return { point, correction: new Float64Array(this.ell), forces: new Float64Array(this.m), plastic: new Float64Array(this.size),
        cumulated: new Float64Array(this.points), active: new Uint8Array(this.m), elastic: null, largest: 0 };
    }

    /* A history of proportional loading from rest, at the point of the box nearest to zero: rest, then its increments. */
    begun(point) {
      const { lower, upper } = this.model.tree;
      const rest = this.rest(point.map((x, k) => (this.fixed.includes(k) ? x : Math.min(Math.max(0, lower[k]), upper[k]))));
      return [rest, ...this.went(rest, point)];
    }

    /* Increments from a state to a point, each a small part of the box, and those of a path that continues; fewer if one
       does not converge. */
    went(before, point) {
      const { lower, upper } = this.model.tree, found = [];
      const far = Math.max(...point.map((x, k) => Math.abs(x - before.point[k]) / (upper[k] - lower[k] || 1)));
      const steps = Math.max(1, Math.ceil(far * STEPS - 1e-9));
      let state = before;
      for (let step = 1; step <= steps; step++) {
        const next = step === steps ? point.slice() : point.map((x, k) => before.point[k] + ((x - before.point[k]) * step) / steps);
        state = this.reached(state, next);
        if (!state) break;
        found.push(state);
      }
      return found;
    }

    /* An increment, in halves if necessary; null if it does not converge. */
    reached(before, point, depth = 0) {
      const whole = this.increment(before, point);
      if (whole || depth === HALVED) return whole;
      const half = this.reached(before, before.point.map((x, k) => (x + point[k]) / 2), depth + 1);
      return half && this.reached(half, point, depth + 1);
    }

    increment(before, point) {
      const theta = this.model.theta(point), elasticity = this.elasticity(point), laws = this.laws(point);
      if (!laws || !this.model.possible(point)) return null;
      const load = { theta, ...elasticity, laws, before, slack: this.slack(theta, elasticity), strain: this.strain(theta, elasticity) };
      const elastic = this.model.touched({ schur: load.schur, slack: load.slack }, before.elastic);
      if (!elastic) return null;
      load.elastic = elastic.forces;
      const found = this.newton(load, before.correction, before.active);
      return found && this.small(found.strain) && { point, theta, gives: elasticity.gives, elastic: elastic.active, converged: true, ...found };
    }

    /* True if strains are small enough for the theory of small strains. */
    small(strain) {
      const sizes = new Float64Array(this.points);
      strain.forEach((value, k) => { sizes[k % this.points] = Math.max(sizes[k % this.points], Math.abs(value)); });
      sizes.sort();
      return sizes[this.points - Math.max(Math.floor(ALONE * this.points), 1)] <= MOST && sizes[this.points - 1] <= RUNAWAY;
    }

    /* Slack without correction and forces. */
    slack(theta, { gives }) {
      const { m, terms } = this, found = new Float64Array(m);
      for (let i = 0; i < m; i++) for (let t = 0; t < terms; t++) {
        let share = this.gaps[i * terms + t];
        gives.forEach((c, q) => { share -= c * this.pressed[(q * m + i) * terms + t]; });
        found[i] += share * theta[t];
      }
      return found;
    }

    /* Strain without correction and forces. */
    strain(theta, { scale }) {
      const { size, points, terms } = this, found = new Float64Array(size);
      for (let k = 0; k < size; k++) for (let t = 0; t < terms; t++) {
        found[k] += (scale[k % points] * this.forced[k * terms + t] + this.given[k * terms + t]) * theta[t];
      }
      return found;
    }

    /* The correction of an increment and all that follows from it; null without convergence. */
    newton(load, start, active) {
      let here = this.tried(load, start, active), largest = load.before.largest;
      if (!here) return null;
      largest = Math.max(largest, (ROUND_OFF * this.weight * norm(here.strain)) / TOLERANCE);
      for (let iteration = 0; iteration < NEWTON; iteration++) {
        if (here.merit <= TOLERANCE * Math.max(norm(here.correction), largest)) {
          return { ...here, largest: Math.max(largest, norm(here.correction)), iterations: iteration };
        }
        const next = this.quick(load, here) ?? this.careful(load, here);
        if (!next) return null;
        here = next;
      }
      return null;
    }

    /* A step with the cached matrix, if it decreases the residual enough. */
    quick(load, here) {
      if (!this.tangent) return null;
      const next = this.tried(load, this.stepped(here, 1), here.active);
      return next && next.merit <= QUICK * here.merit ? next : null;
    }

    /* A step with the matrix of the current iterate, shortened until the residual decreases. */
    careful(load, here) {
      this.tangent = this.linearised(load, here);
      for (let share = 1; this.tangent && share >= LEAST; share /= 2) {
        const next = this.tried(load, this.stepped(here, share), here.active);
        if (next && next.merit <= (1 - DECREASE * share) * here.merit) return next;
      }
      this.tangent = null;
      return null;
    }

    stepped({ correction, residual }, share) {
      const { jacobian, order } = this.tangent, step = hhr.solved(jacobian, this.ell, order, Float64Array.from(residual));
      return correction.map((x, j) => x + share * step[j]);
    }

    /* Contact forces, strain, plastic increment and residual at a correction; null without a solution. */
    tried(load, correction, start) {
      const { ell, m, size, points, components } = this, slack = Float64Array.from(load.slack), strain = Float64Array.from(load.strain);
      for (let i = 0; i < m; i++) for (let j = 0; j < ell; j++) slack[i] -= this.moved[i * ell + j] * correction[j];
      const contact = this.model.touched({ schur: load.schur, slack }, start);
      if (!contact) return null;
      const pushed = new Float64Array(size);
      contact.forces.forEach((force, i) => { if (force !== 0) for (let k = 0; k < size; k++) pushed[k] += force * this.per_force[i * size + k]; });
      for (let k = 0; k < size; k++) strain[k] -= load.scale[k % points] * pushed[k];
      for (let j = 0; j < ell; j++) for (let k = 0; k < size; k++) strain[k] += correction[j] * this.per_mode[j * size + k];
      const { shear, yields, hardens } = load.laws, old = load.before, deviator = new Float64Array(size);
      const plastic = Float64Array.from(old.plastic), cumulated = Float64Array.from(old.cumulated);
      const amount = new Float64Array(points), slope = new Float64Array(points), trial = new Float64Array(points);
      for (let k = 0; k < points; k++) {
        const mean = (strain[k] + strain[points + k] + strain[2 * points + k]) / 3;
        for (let i = 0; i < components; i++) {
          const place = i * points + k;
          deviator[place] = 2 * shear[k] * (strain[place] - old.plastic[place] - (i < 3 ? mean : 0));
          trial[k] += deviator[place] ** 2;
        }
        trial[k] = Math.sqrt(1.5 * trial[k]);
        const over = trial[k] - yields[k] - hardens[k] * old.cumulated[k];
        if (!(over > 0)) continue;
        slope[k] = 1 / (3 * shear[k] + hardens[k]);
        amount[k] = over * slope[k];
        cumulated[k] += amount[k];
        for (let i = 0; i < components; i++) plastic[i * points + k] += ((1.5 * amount[k]) / trial[k]) * deviator[i * points + k];
      }
      const residual = new Float64Array(ell);
      for (let j = 0; j < ell; j++) {
        for (let k = 0; k < size; k++) residual[j] += this.tested[j * size + k] * plastic[k];
        for (let i = 0; i < ell; i++) residual[j] -= this.modal[j * ell + i] * correction[i];
        for (let i = 0; i < m; i++) residual[j] -= load.coupled[j * m + i] * (contact.forces[i] - load.elastic[i]);
      }
      const merit = norm(residual);
      return Number.isFinite(merit) ? { correction, strain, deviator, plastic, cumulated, amount, slope, trial, residual, merit, ...contact } : null;
    }

    /* Newton's matrix, factored: -J = Q + P_A W less the plastic part of E_p - E_X,A^T W, with W = S_AA^-1 (B V)_A. */
    linearised(load, here) {
      const { ell, m } = this, on = [];
      here.active.forEach((is, i) => { if (is) on.push(i); });
      const n = on.length, inner = new Float64Array(n * n), pivots = new Int32Array(n);
      on.forEach((i, a) => on.forEach((j, b) => { inner[a * n + b] = load.schur[i * m + j]; }));
      if (n && !hhr.factor(inner, n, pivots)) return null;
      const jacobian = Float64Array.from(this.modal), columns = [];
      for (let j = 0; j < ell; j++) {
        const column = Float64Array.from(on, (i) => this.moved[i * ell + j]);
        columns.push(n ? hhr.solved(inner, n, pivots, column) : column);
        on.forEach((i, a) => { for (let row = 0; row < ell; row++) jacobian[row * ell + j] += load.coupled[row * m + i] * column[a]; });
      }
      this.flowOf(load, here, on, columns, jacobian);
      const order = new Int32Array(ell);
      return hhr.factor(jacobian, ell, order) && jacobian.every(Number.isFinite) ? { jacobian, order } : null;
    }

    /* Subtracts the plastic part from the matrix, if there is any. */
    flowOf(load, { deviator, amount, slope, trial }, on, columns, jacobian) {
      const { ell, size, points, components } = this, { shear } = load.laws, places = [];
      amount.forEach((flow, k) => { if (flow > 0) for (let i = 0; i < components; i++) places.push(i * points + k); });
      const count = places.length, flowing = new Float64Array(count), under = [];
      const rows = on.map((i) => Float64Array.from(places, (place) => load.scale[place % points] * this.per_force[i * size + place]));
      for (let j = 0; j < ell; j++) {
        const strain = Float64Array.from(places, (place) => this.per_mode[j * size + place]);
        rows.forEach((row, a) => { const share = columns[j][a]; for (let p = 0; p < count; p++) strain[p] -= share * row[p]; });
        under.push(strain);
      }
      for (let j = 0; j < ell; j++) {
        for (let first = 0; first < count; first += components) {
          const k = places[first], turned = (3 * shear[k] * amount[k]) / trial[k], along = (1.5 * (3 * shear[k] * slope[k] - turned)) / trial[k] ** 2;
          let onto = 0;
          for (let p = first; p < first + components; p++) onto += this.tested[j * size + places[p]] * deviator[places[p]];
          for (let p = first; p < first + components; p++) flowing[p] = this.tested[j * size + places[p]] * turned + onto * along * deviator[places[p]];
        }
        for (let l = 0; l < ell; l++) {
          const strain = under[l];
          let total = 0;
          for (let p = 0; p < count; p++) total += flowing[p] * strain[p];
          jacobian[j * ell + l] -= total;
        }
      }
    }

    /* Rows of a displacement: of corrections, of forces and loads by part, and of imposed displacements. */
    along(rows, { correction, forces, theta, gives }) {
      const [modes, given, pushed, forced] = ["modes", "given", "pushed", "forced"].map((name) => this.model.arrays[rows[name]]);
      const { ell, m, terms } = this, count = modes.length / ell, found = new Float64Array(count);
      for (let r = 0; r < count; r++) {
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
    estimate({ strain, plastic, point, gives }) {
      const { points, components } = this, { modes, scales, without } = this.flow.unforeseen, inner = this.model.arrays[without];
      const shown = this.model.arrays[modes], count = scales.length, shares = new Float64Array(count), at = (k, i) => plastic[i * points + k];
      for (let a = 0; a < count; a++) for (let k = 0; k < points; k++) for (let i = 0; i < components; i++) {
        shares[a] += scales[a] ** 2 * shown[(a * points + k) * components + i] * at(k, i);
      }
      let left = 0, stress = 0, place = 0;
      this.flow.groups.forEach(({ points: own, young, poisson }) => {
        const E = hhr.formula(young, point), lame = (E * poisson) / ((1 + poisson) * (1 - 2 * poisson)), twice = E / (1 + poisson);
        for (let k = place; k < place + own; k++) {
          const open = [], strains = [];
          for (let i = 0; i < components; i++) {
            let value = at(k, i);
            for (let a = 0; a < count; a++) value -= shown[(a * points + k) * components + i] * shares[a];
            open.push(value);
            strains.push(strain[i * points + k] - at(k, i));
          }
          const volume = strains[0] + strains[1] + strains[2];
          for (let i = 0; i < components; i++) {
            let value = 0;
            for (let j = 0; j < components; j++) value += inner[(k * components + i) * components + j] * open[j];
            left += (value / gives[this.parts[k]]) ** 2;
            stress += (twice * strains[i] + (i < 3 ? lame * volume : 0)) ** 2;
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

  hhr.Flowing = Flowing;
})(typeof module !== "undefined" ? require("./model.js") : hhr);
