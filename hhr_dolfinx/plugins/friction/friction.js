"use strict";
/* Increments with friction, with one tangent per contact, or two in space: statuses and directions by a semi-smooth Newton
   method, as in contact.sliding_set in Python. If it does not converge, sweeps over single contacts improve the forces.
   In space slip may turn: the force across it is an unknown, see contact/sliding_system.py. Needs model.js. */

((hhr) => {
  const TOLERANCE = 1e-11, ROUND_OFF = 1e-15, PROBES = [0.2, 1, 0.01], NEWTON = 40, GIVES = 1e-4, HALVED = 6;
  const FEWEST = 4, CUTS = 12, SETTLED = 1e-3, WORK = 1e-3, APART = 1e-9;
  const SWEEPS = [10, 30, 100, 300, 1000, 3000];
  const largest = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);

  class Sliding {
    constructor(model) {
      const { friction } = model.tree;
      this.model = model;
      this.laws = friction.laws;
      this.fixed = friction.fixed;
      for (const name of ["normal", "tangential", "owner", "area", "law", "twice", "tangents"]) this[name] = model.arrays[friction[name]];
      this.pressing = new Uint8Array(model.m).fill(1);
      this.along = Array.from(this.normal, () => []); // tangential rows of each contact
      this.tangential.forEach((row, k) => { this.pressing[row] = 0; this.along[this.owner[k]].push(row); });
    }

    /* Undeformed bodies at a point, without slip. */
    rest(point) {
      const state = this.blank(point), { slack } = this.model.contact(point);
      this.normal.forEach((row, k) => { state.gap[k] = slack[row]; });
      return state;
    }

    /* State of contacts at the start. */
    blank(point) {
      const count = this.normal.length, none = () => new Float64Array(count);
      return { point, forces: new Float64Array(this.model.m), position: new Float64Array(this.tangential.length), path: none(),
        work: none(), wear: none(), pressure: none(), bound: none(), gap: none(), energy: 0, statuses: new Uint8Array(count) };
    }

    /* Coefficient and largest tangential force of each contact at a point; infinite without a limit. */
    bounds(point) {
      const laws = this.laws.map((pair) => pair.map((steps) => (steps ? hhr.formula(steps, point) : Infinity)));
      return { coefficient: Array.from(this.law, (law) => laws[law][0]),
        limit: Array.from(this.law, (law, k) => laws[law][1] * (laws[law][1] === Infinity ? 1 : this.area[k])) };
    }

    bound({ coefficient, limit }, contact, force) {
      const carried = coefficient[contact] === Infinity ? Infinity : coefficient[contact] * Math.max(force, 0);
      return Math.min(carried, limit[contact]);
    }

    /* State after an increment to a point; null if it does not converge. */
    increment(before, point) {
      if (!this.model.possible(point)) return null;
      const contact = this.model.contact(point), slack = contact.slack, given = this.bounds(point);
      this.tangential.forEach((row, k) => { slack[row] -= before.position[k]; });
      const found = this.settled(this.softened(contact.schur), slack, given, before.forces);
      return found && this.after(before, { ...found, point, given, theta: contact.theta, energy: this.energy(contact.schur, found) });
    }

    /* The same, in halves if necessary. */
    reached(before, point, depth = 0) {
      const whole = this.increment(before, point);
      if (whole || depth === HALVED) return whole;
      const half = this.reached(before, before.point.map((x, k) => (x + point[k]) / 2), depth + 1);
      return half && this.reached(half, point, depth + 1);
    }

    /* Result of an increment from a state; nothing if it does not converge. */
    went(before, point) {
      const state = this.reached(before, point);
      return state ? [state] : [];
    }

    /* States of proportional loading from rest, at the point of the box nearest to zero. Increments are halved until that
       changes little, as in models.histories.sliding. */
    begun(point) {
      const { lower, upper } = this.model.tree;
      const from = point.map((x, k) => (this.fixed.includes(k) ? x : Math.min(Math.max(0, lower[k]), upper[k])));
      const states = [this.rest(from)], scale = { forces: 0, energy: 0 };
      let state = states[0];
      for (let step = 1; state && step <= FEWEST; step++) {
        const next = step === FEWEST ? point : from.map((x, k) => x + ((point[k] - x) * step) / FEWEST);
        state = this.careful(state, next, states, scale, 0);
      }
      return states;
    }

    careful(before, point, states, scale, depth) {
      const whole = this.tried(before, point, scale);
      if (depth >= (whole ? CUTS : HALVED)) {
        if (whole) states.push(whole);
        return whole;
      }
      const middle = before.point.map((x, k) => (x + point[k]) / 2), half = this.tried(before, middle, scale);
      const second = whole && half && this.tried(half, point, scale);
      if (second && (this.difference(before, half, second, whole, scale) <= SETTLED || depth + 1 >= CUTS)) {
        states.push(half, second);
        return second;
      }
      const first = this.careful(before, middle, states, scale, depth + 1);
      return first && this.careful(first, point, states, scale, depth + 1);
    }

    /* An increment that counts in the denominators of errors, also if the path discards it. */
    tried(before, point, scale) {
      const state = this.increment(before, point);
      if (state) {
        scale.forces = Math.max(scale.forces, Math.hypot(...state.forces));
        scale.energy = Math.max(scale.energy, state.energy);
      }
      return state;
    }

    /* Error estimate by halving an increment: forces over the largest, dissipated work over the total of the path. */
    difference(before, half, second, whole, scale) {
      const norm = (values) => Math.hypot(...values), sum = (values) => values.reduce((t, x) => t + x, 0);
      const closing = Math.hypot(this.held(before, half), this.held(half, second)), work = sum(second.work);
      const off = norm(second.forces.map((x, i) => x - whole.forces[i])) + closing;
      return Math.max(off / (scale.forces || 1), Math.abs(work - sum(whole.work)) / (work + WORK * scale.energy || 1));
    }

    /* Sticking force of contacts that closed in this increment; its reference is the start of the increment. */
    held(before, after) {
      const apart = APART * largest(before.gap);
      let square = 0;
      this.tangential.forEach((row, k) => {
        const contact = this.owner[k];
        if (after.pressure[contact] > 0 && before.gap[contact] > apart) square += after.forces[row] ** 2;
      });
      return Math.sqrt(square);
    }

    /* Elastic energy of contact forces, with S without regularisation. */
    energy(schur, { forces, pushed }) {
      const soft = this.twice.reduce((t, row) => t + GIVES * schur[row * this.model.m + row] * forces[row] ** 2, 0);
      return 0.5 * (forces.reduce((t, x, i) => t + x * pushed[i], 0) - soft);
    }

    /* State after an increment: bounds and pressures along a slip are the means of both ends. */
    after(before, { forces, slack, at, point, given, theta, energy }) {
      const { normal, tangential } = this, state = Object.assign(this.blank(point), { forces, theta, energy, converged: true });
      const slipped = new Float64Array(normal.length), slides = new Uint8Array(normal.length);
      tangential.forEach((row, k) => {
        state.position[k] = before.position[k] + slack[row];
        slipped[this.owner[k]] = Math.hypot(slipped[this.owner[k]], slack[row]);
        slides[this.owner[k]] = at.slips[row];
      });
      normal.forEach((row, k) => {
        const pressure = Math.max(forces[row], 0), bound = this.bound(given, k, forces[row]);
        const closed = 0.5 * ((before.pressure[k] > 0) + (pressure > 0)), mean = 0.5 * (before.pressure[k] + pressure);
        state.gap[k] = slack[row];
        state.pressure[k] = pressure;
        state.bound[k] = bound;
        state.path[k] = before.path[k] + slipped[k] * closed;
        state.work[k] = before.work[k] + 0.5 * (before.bound[k] + bound) * slipped[k];
        state.wear[k] = before.wear[k] + (this.area[k] > 0 ? mean / this.area[k] : 0) * slipped[k];
        state.statuses[k] = !at.acting[row] ? 0 : slides[k] ? 2 : 1;
      });
      return state;
    }

    /* Regularise redundant rows; rows that act on no unknown by a part of the compliance of their pressure. */
    softened(schur) {
      if (!this.twice.length) return schur;
      if (this.last?.given === schur) return this.last.found;
      const found = Float64Array.from(schur);
      const m = this.model.m;
      this.twice.forEach((row) => {
        const pressure = this.normal[this.owner[this.tangential.indexOf(row)]], own = schur[row * m + row];
        found[row * m + row] += GIVES * (own > 0 ? own : schur[pressure * m + pressure]);
      });
      this.last = { given: schur, found };
      return found;
    }

    settled(schur, slack, given, start) {
      const m = this.model.m, stiffness = Float64Array.from(slack, (_, i) => 1 / Math.abs(schur[i * m + i]));
      // the same for both directions of a contact: the projection is on a disc
      for (const rows of this.along) { const own = Math.min(...rows.map((row) => stiffness[row])); rows.forEach((row) => { stiffness[row] = own; }); }
      let found = null, forces = start;
      for (const sweeps of [0, ...SWEEPS]) {
        if (sweeps) forces = this.swept(schur, slack, given, stiffness, forces, sweeps);
        for (const probe of PROBES) if ((found = this.newton(schur, slack, given, stiffness, forces, probe))) return found;
      }
      return null;
    }

    newton(schur, slack, given, stiffness, start, probe) {
      const m = this.model.m, noise = ROUND_OFF * largest(slack.map((s, i) => stiffness[i] * s)), seen = new Set();
      let forces = start, least = Infinity;
      for (let iteration = 0; iteration <= NEWTON; iteration++) {
        const left = this.left(schur, slack, forces), at = this.projected(given, stiffness, forces, left, probe);
        if (at.worst <= TOLERANCE * largest(forces) + noise) {
          forces = forces.map((x, i) => (at.acting[i] ? x : 0));
          return { forces, at, pushed: left.map((s, i) => s - slack[i]), slack: left.map((s, i) => (at.acting[i] && !at.slips[i] ? 0 : s)) };
        }
        const key = at.acting.join("") + at.slips.join("") + at.limited.join("") + at.ways.map(Math.sign).join("");
        if (seen.has(key) && !(at.worst < 0.5 * least)) return null;
        seen.add(key);
        least = Math.min(least, at.worst);
        forces = this.solved(schur, slack, given, stiffness, at);
        if (!forces || !forces.every(Number.isFinite)) return null;
      }
      return null;
    }

    left(schur, slack, forces) {
      const m = this.model.m, found = Float64Array.from(slack);
      for (let j = 0; j < m; j++) if (forces[j] !== 0) for (let i = 0; i < m; i++) found[i] += schur[i * m + j] * forces[j];
      return found;
    }

    /* Statuses from forces and slacks, and the residual; slipping contacts have a direction along their rows, and shrunk is
       the bound over the projected force. */
    projected(given, stiffness, forces, left, probe) {
      const m = this.model.m, acting = new Uint8Array(m), slips = new Uint8Array(m), limited = new Uint8Array(m);
      const ways = new Float64Array(m), shrunk = new Float64Array(this.normal.length);
      const y = forces.map((x, i) => x - stiffness[i] * left[i]);
      let worst = 0;
      for (let i = 0; i < m; i++) if (this.pressing[i]) {
        acting[i] = y[i] > 0 ? 1 : 0;
        worst = Math.max(worst, Math.abs(forces[i] - Math.max(y[i], 0)));
      }
      this.normal.forEach((normal, contact) => {
        const rows = this.along[contact], bound = this.bound(given, contact, y[normal]);
        const share = this.share(bound, Math.hypot(...rows.map((row) => y[row])));
        const pushed = rows.map((row) => forces[row] + probe * (y[row] - forces[row])), size = Math.hypot(...pushed);
        const bears = acting[normal] || bound > 0;
        shrunk[contact] = this.share(bound, size);
        rows.forEach((row, k) => {
          worst = Math.max(worst, Math.abs(forces[row] - share * y[row]));
          acting[row] = bears ? 1 : 0;
          limited[row] = bound >= given.limit[contact] ? 1 : 0;
          slips[row] = bears && size > bound ? 1 : 0;
          ways[row] = slips[row] ? pushed[k] / size : 0;
        });
      });
      return { acting, slips, limited, ways, shrunk, probe, worst };
    }

    share(bound, size) {
      return size > bound ? bound / size : 1;
    }

    /* Forces for given statuses; null if they are undetermined. A slipping force is proportional to its pressure, or at its
       limit, and turns in space: (1 - s) α + s p c e·slack = 0 for the force α across, along e, with s = shrunk. */
    solved(schur, slack, given, stiffness, { acting, slips, limited, ways, shrunk, probe }) {
      const m = this.model.m, columns = [], place = new Int32Array(m).fill(-1), known = new Float64Array(m);
      for (let i = 0; i < m; i++) if (acting[i] && !slips[i]) place[i] = columns.push({ parts: [[i, 1]], tests: [[i, 1]], own: 0 }) - 1;
      this.normal.forEach((normal, contact) => {
        const rows = this.along[contact].filter((row) => slips[row]), follows = place[normal];
        for (const row of rows) {
          if (limited[row]) known[row] = ways[row] * given.limit[contact];
          else if (follows >= 0) columns[follows].parts.push([row, ways[row] * given.coefficient[contact]]);
        }
        if (rows.length !== 2) return;
        const across = [[rows[0], -ways[rows[1]]], [rows[1], ways[rows[0]]]], yields = shrunk[contact];
        columns.push({ parts: across, tests: across.map(([row, e]) => [row, e * yields * probe * stiffness[row]]), own: 1 - yields });
      });
      const n = columns.length, a = new Float64Array(n * n), x = new Float64Array(n), pushed = this.left(schur, slack, known);
      columns.forEach(({ tests, own }, r) => {
        for (const [i, weight] of tests) {
          x[r] -= weight * pushed[i];
          columns.forEach(({ parts }, c) => { for (const [j, share] of parts) a[r * n + c] += weight * share * schur[i * m + j]; });
        }
        a[r * n + r] += own;
      });
      const pivots = new Int32Array(n), forces = known;
      if (!hhr.factor(a, n, pivots)) return null;
      hhr.solved(a, n, pivots, x);
      columns.forEach(({ parts }, c) => { for (const [row, share] of parts) forces[row] += share * x[c]; });
      return forces;
    }

    /* Projections of single contacts, one after another. */
    swept(schur, slack, given, stiffness, start, count) {
      const m = this.model.m, forces = Float64Array.from(start, (x) => (Number.isFinite(x) ? x : 0));
      const pushed = (i) => { let s = slack[i]; for (let j = 0; j < m; j++) s += schur[i * m + j] * forces[j]; return forces[i] - stiffness[i] * s; };
      for (let sweep = 0; sweep < count; sweep++) {
        for (let i = 0; i < m; i++) if (this.pressing[i]) forces[i] = Math.max(0, pushed(i));
        this.along.forEach((rows, contact) => {
          const y = rows.map(pushed), share = this.share(this.bound(given, contact, forces[this.normal[contact]]), Math.hypot(...y));
          rows.forEach((row, k) => { forces[row] = share * y[k]; });
        });
      }
      return forces;
    }
  }

  hhr.Sliding = Sliding;
})(typeof module !== "undefined" ? require("../pages/model.js") : hhr);
