"use strict";
/* Histories of inelastic bodies: plastic corrections g and all contact forces of an increment, by Newton's method with a
   line search, as in inelastic.condensed_step in Python. The arrays are described in
   inelastic.condensed_flow; strains and memory are stored component by component. Contacts that rub are those of friction.js,
   as in friction.rubbing_flow: each correction has an increment of friction. Needs programs.js. */

((hhr) => {
  const TOLERANCE = 1e-11, ROUND_OFF = 1e-14, NEWTON = 60, LEAST = 1 / 256, DECREASE = 1e-4, HALVED = 6, QUICK = 0.1;
  const STILL = 1e-12; // a point does not flow if no slope of its inelastic strain is larger: these are round-off
  const MOST = 1, ALONE = 0.01, RUNAWAY = 100; // limits of small strains, see models.strains
  const STEPS = 40, HELD = 10; // increments from one end of a parameter's range to the other; least of a move that takes time
  const norm = (values) => Math.sqrt(values.reduce((t, x) => t + x * x, 0));

  class Flowing {
    constructor(model) {
      const { flow } = model.tree, own = (name) => model.arrays[flow[name]];
      const rubs = model.tree.friction ? new hhr.Sliding(model) : null;
      Object.assign(this, { model, flow, m: model.m, fixed: flow.fixed, moduli: null, tangent: null, rubs });
      for (const name of ["per_mode", "per_force", "forced", "given", "moved", "modal", "coupled", "pressed", "gaps", "parts", "mode_parts"]) this[name] = own(name);
      this.ell = this.per_mode.shape[0];
      this.points = this.parts.length;
      this.size = this.per_mode.shape[1];
      this.components = this.size / this.points;
      this.terms = this.gaps.shape[1];
      const halves = own("schur"), count = halves.shape[0], half = halves.length / count;
      this.groups = flow.groups.map(({ law, places, elastic, compliance, ...rest }) => ({ ...rest, law: law && new hhr.Law(model.arrays, law),
        places: places && model.arrays[places], elastic: model.arrays[elastic], compliance: model.arrays[compliance] }));
      this.grading = flow.groups.flatMap(({ grading, points }) => Array.from(grading ? model.arrays[grading] : { length: points }, (x) => x ?? 1)); // factor of C
      this.tested = this.testedBy(own("weights"));
      this.weight = norm(this.tested);
      this.rows = Math.max(this.components + 1, ...this.groups.map(({ law }) => (law ? law.sizes.memory : 0)));
      this.rated = flow.groups.some(({ rated }) => rated);
      this.seconds = 1; // of a move
      this.schurs = Array.from({ length: count }, (_, q) => model.whole(halves.subarray(q * half, (q + 1) * half)));
      model.flow = this;
    }

    /* Weights times the stress of each mode. */
    testedBy(weights) {
      const { ell, size, points, components: c } = this, found = new Float64Array(ell * size);
      let k = 0;
      for (const { points: count, elastic } of this.groups) for (const end = k + count; k < end; k++) {
        for (let j = 0; j < ell; j++) for (let i = 0; i < c; i++) for (let l = 0; l < c; l++) {
          found[j * size + i * points + k] += weights[k] * this.grading[k] * elastic[i * c + l] * this.per_mode[j * size + l * points + k];
        }
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
      let first = 0;
      const compliances = this.groups.map(({ compliance, points: count }) => {
        first += count;
        return compliance.map((x) => x * scale[first - 1]); // all points of a body are on parts of one modulus
      });
      return (this.moduli = { key, gives, schur, scale, coupled, compliances });
    }

    /* E, the ratio of Poisson and the constants of the law of each point; null if they are invalid. */
    constants(point) {
      const found = [];
      for (const { points, law, constants, places } of this.groups) {
        const at = (place) => constants.map((steps) => hhr.formula(steps, [...point, ...place])), alike = places ? null : at([]);
        for (let k = 0; k < points; k++) {
          const own = alike ?? at(places.subarray((k * places.length) / points, ((k + 1) * places.length) / points));
          if (!(own[0] > 0) || (law && !law.takes(own))) return null;
          found.push(own);
        }
      }
      return found;
    }

    /* Memory at the end of a step; null if a law has no answer. `visit` takes each point with its law, which was solved there,
       and C^-1. */
    updated({ constants, compliances, before, dt }, strain, visit) {
      const { points, components } = this, found = Float64Array.from(before.memory), own = new Float64Array(components), old = new Float64Array(this.rows);
      let k = 0;
      for (const [g, { points: count, law }] of this.groups.entries()) for (const end = k + count; k < end; k++) {
        if (!law) continue;
        const { memory } = law.sizes;
        for (let i = 0; i < memory; i++) old[i] = before.memory[i * points + k];
        for (let i = 0; i < components; i++) own[i] = strain[i * points + k];
        const compliance = this.grading[k] === 1 ? compliances[g] : compliances[g].map((x) => x / this.grading[k]);
        if (!law.solve(own, old, dt, constants[k], compliance)) return null;
        for (let i = 0; i < memory; i++) found[i * points + k] = law.memory[i];
        visit?.(k, law, compliance);
      }
      return found;
    }

    /* Undeformed bodies at a point, without plastic strain. */
    rest(point) {
      return this.remembering({ ...this.rubs?.blank(point), point, time: 0, correction: new Float64Array(this.ell), forces: new Float64Array(this.m),
        memory: new Float64Array(this.rows * this.points), active: new Uint8Array(this.m), elastic: null, largest: 0 });
    }

    /* A state with names for parts of its memory. */
    remembering(state) {
      const { size, points } = this;
      return { ...state, plastic: state.memory.subarray(0, size), cumulated: state.memory.subarray(size, size + points) };
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
      const steps = Math.max(this.rated ? HELD : 1, Math.ceil(far * STEPS - 1e-9));
      let state = before;
      for (let step = 1; step <= steps; step++) {
        const next = step === steps ? point.slice() : point.map((x, k) => before.point[k] + ((x - before.point[k]) * step) / steps);
        state = this.reached(state, next, this.seconds / steps);
        if (!state) break;
        found.push(state);
      }
      return found;
    }

    /* An increment of some seconds, in halves if necessary; null if it does not converge. */
    reached(before, point, dt = this.seconds, depth = 0) {
      const whole = this.increment(before, point, dt);
      if (whole || depth === HALVED) return whole;
      const half = this.reached(before, before.point.map((x, k) => (x + point[k]) / 2), dt / 2, depth + 1);
      return half && this.reached(half, point, dt / 2, depth + 1);
    }

    increment(before, point, dt) {
      const theta = this.model.theta(point), elasticity = this.elasticity(point), constants = this.constants(point);
      if (!constants || !this.model.possible(point)) return null;
      const load = { theta, ...elasticity, constants, dt, before, slack: this.slack(theta, elasticity), strain: this.strain(theta, elasticity) };
      const elastic = this.ready(load, point);
      const found = elastic && this.newton(load, before.correction, before);
      return found && this.small(found.strain) && this.remembering({ ...this.rubbed(load, point, found), point, time: before.time + dt, theta,
        gives: elasticity.gives, elastic: elastic.active, converged: true, ...found });
    }

    /* What a contact problem of an increment takes: forces of elastic bodies, by which the cubature is corrected, or, where
       contacts rub and forces depend on the path, laws of friction at a point and slacks less what has slipped. */
    ready(load, point) {
      if (!this.rubs) {
        const elastic = this.model.touched({ schur: load.schur, slack: load.slack }, load.before.elastic);
        load.elastic = elastic?.forces;
        return elastic;
      }
      Object.assign(load, { given: this.rubs.bounds(point), softened: this.rubs.softened(load.schur), elastic: new Float64Array(this.m) });
      this.rubs.slipped(load.slack, load.before);
      return { active: null };
    }

    /* The contact problem under a slack, from the forces and statuses of a trial or a state. */
    touched(load, slack, { active, forces }) {
      if (!this.rubs) return this.model.touched({ schur: load.schur, slack }, active);
      const found = slack.every(Number.isFinite) && this.rubs.settled(load.softened, slack, load.given, forces);
      return found && { forces: found.forces, slack: found.slack, active: found.at.acting, rubbing: found };
    }

    /* State of contacts that rub after an increment. */
    rubbed({ before, given, schur }, point, { rubbing }) {
      return rubbing && this.rubs.after(before, { ...rubbing, point, given, energy: this.rubs.energy(schur, rubbing, []) });
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
    newton(load, start, before) {
      let here = this.tried(load, start, before), largest = load.before.largest;
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
      const next = this.tried(load, this.stepped(here, 1), here);
      return next && next.merit <= QUICK * here.merit ? next : null;
    }

    /* A step with the matrix of the current iterate, shortened until the residual decreases. */
    careful(load, here) {
      this.tangent = this.linearised(load, here);
      for (let share = 1; this.tangent && share >= LEAST; share /= 2) {
        const next = this.tried(load, this.stepped(here, share), here);
        if (next && next.merit <= (1 - DECREASE * share) * here.merit) return next;
      }
      this.tangent = null;
      return null;
    }

    stepped({ correction, residual }, share) {
      const { jacobian, order } = this.tangent, step = hhr.solved(jacobian, this.ell, order, Float64Array.from(residual));
      return correction.map((x, j) => x + share * step[j]);
    }

    /* Contact forces, strain, memory and residual at a correction; null without a solution. */
    tried(load, correction, start) {
      const { ell, m, size, points } = this, slack = Float64Array.from(load.slack), strain = Float64Array.from(load.strain);
      for (let i = 0; i < m; i++) for (let j = 0; j < ell; j++) slack[i] -= this.moved[i * ell + j] * correction[j];
      const contact = this.touched(load, slack, start);
      if (!contact) return null;
      const pushed = new Float64Array(size);
      contact.forces.forEach((force, i) => { if (force !== 0) for (let k = 0; k < size; k++) pushed[k] += force * this.per_force[i * size + k]; });
      for (let k = 0; k < size; k++) strain[k] -= load.scale[k % points] * pushed[k];
      for (let j = 0; j < ell; j++) for (let k = 0; k < size; k++) strain[k] += correction[j] * this.per_mode[j * size + k];
      const memory = this.updated(load, strain);
      if (!memory) return null;
      const residual = new Float64Array(ell);
      for (let j = 0; j < ell; j++) {
        for (let k = 0; k < size; k++) residual[j] += this.tested[j * size + k] * memory[k];
        for (let i = 0; i < ell; i++) residual[j] -= this.modal[j * ell + i] * correction[i];
        for (let i = 0; i < m; i++) residual[j] -= load.coupled[j * m + i] * (contact.forces[i] - load.elastic[i]);
      }
      const merit = norm(residual);
      return Number.isFinite(merit) ? { correction, strain, memory, residual, merit, ...contact } : null;
    }

    /* Derivatives of the forces of some conditions, on, by the corrections, on their statuses: W = S_AA^-1 (B V)_A, or those of
       an increment with friction; null if they are undetermined. */
    pushes(load, { active, rubbing }) {
      const { ell, m } = this, on = [];
      active.forEach((is, i) => { if (is) on.push(i); });
      const n = on.length, modes = [...Array(ell).keys()];
      if (rubbing) {
        const along = this.rubs.slopes(load.softened, load.given, rubbing);
        const columns = along && modes.map((j) => along(Float64Array.from({ length: m }, (_, i) => -this.moved[i * ell + j])));
        return columns && { on, columns: columns.map((column) => Float64Array.from(on, (i) => column[i])) };
      }
      const inner = new Float64Array(n * n), pivots = new Int32Array(n);
      on.forEach((i, a) => on.forEach((j, b) => { inner[a * n + b] = load.schur[i * m + j]; }));
      if (n && !hhr.factor(inner, n, pivots)) return null;
      const columns = modes.map((j) => Float64Array.from(on, (i) => this.moved[i * ell + j]));
      return { on, columns: columns.map((column) => (n ? hhr.solved(inner, n, pivots, column) : column)) };
    }

    /* Newton's matrix, factored: -J = Q + P_A W less the plastic part of E_p - E_X,A^T W. */
    linearised(load, here) {
      const { ell, m } = this, pushes = this.pushes(load, here);
      if (!pushes) return null;
      const { on, columns } = pushes, jacobian = Float64Array.from(this.modal);
      columns.forEach((column, j) => {
        on.forEach((i, a) => { for (let row = 0; row < ell; row++) jacobian[row * ell + j] += load.coupled[row * m + i] * column[a]; });
      });
      this.flowOf(load, here, on, columns, jacobian);
      const order = new Int32Array(ell);
      return hhr.factor(jacobian, ell, order) && jacobian.every(Number.isFinite) ? { jacobian, order } : null;
    }

    /* Subtracts the plastic part from the matrix, if there is any: by the slopes 1 - C^-1 H of the points that flow. */
    flowOf(load, { strain, memory }, on, columns, jacobian) {
      const { ell, size, points, components: c } = this, slopes = [], which = [];
      if (memory.every((value, k) => k >= size || value === load.before.memory[k])) return;
      this.updated(load, strain, (k, law, compliance) => {
        const own = this.slopes(law.tangent(), compliance);
        if (!own.every((value) => Math.abs(value) <= STILL)) { slopes.push(own); which.push(k); }
      });
      const places = which.flatMap((k) => Array.from({ length: c }, (_, i) => i * points + k)), count = places.length, flowing = new Float64Array(count);
      const rows = on.map((i) => Float64Array.from(places, (place) => load.scale[place % points] * this.per_force[i * size + place]));
      const under = columns.map((column, j) => {
        const found = Float64Array.from(places, (place) => this.per_mode[j * size + place]);
        rows.forEach((row, a) => { for (let p = 0; p < count; p++) found[p] -= column[a] * row[p]; });
        return found;
      });
      for (let j = 0; j < ell; j++) {
        flowing.fill(0);
        slopes.forEach((own, z) => {
          for (let m = 0; m < c; m++) for (let i = 0; i < c; i++) flowing[z * c + i] += this.tested[j * size + places[z * c + m]] * own[m * c + i];
        });
        for (let l = 0; l < ell; l++) jacobian[j * ell + l] -= hhr.dot(flowing, under[l]);
      }
    }

    /* 1 - C^-1 H of a tangent H. */
    slopes(tangent, compliance) {
      const c = this.components, found = new Float64Array(c * c);
      for (let i = 0; i < c; i++) for (let j = 0; j < c; j++) {
        let slope = i === j ? 1 : 0;
        for (let l = 0; l < c; l++) slope -= compliance[i * c + l] * tangent[l * c + j];
        found[i * c + j] = slope;
      }
      return found;
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

  hhr.Flowing = Flowing;
})(typeof module !== "undefined" ? require("./programs.js") : hhr);
