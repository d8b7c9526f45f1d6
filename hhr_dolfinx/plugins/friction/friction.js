"use strict";
/* Increments with friction, with one tangent per contact, or two in space: statuses and directions by a semi-smooth Newton
   method, as in contact.sliding_set in Python. If it does not converge, sweeps over single contacts improve the forces.
   In space slip may turn: the force across it is an unknown, see contact/sliding_system.py. Rigid motions q of bodies that
   contact alone holds are unknowns too, slack = free slack + S x - G q and G^T x = driving; if that fails, weak springs
   hold the bodies, as in contact.sliding_set. Needs model.js, and floating.js for such bodies; flow.js marches bodies
   that flow, with the contact problem of an increment from here. */

((hhr) => {
  const TOLERANCE = 1e-11, ROUND_OFF = 1e-15, PROBES = [0.2, 1, 0.01], NEWTON = 40, GIVES = 1e-4, HALVED = 6;
  const FEWEST = 4, CUTS = 12, SETTLED = 1e-3, WORK = 1e-3, APART = 1e-9;
  const BALANCED = 1e-10, SINGULAR = 1e-8, HUGE = 1e9; // of bodies with rigid motions
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
      const contact = this.model.contact(point), given = this.bounds(point), slack = this.slipped(contact.slack, before);
      const schur = this.softened(contact.schur), driving = contact.driving ?? [];
      const found = driving.length ? this.free(schur, slack, given, driving, before.forces) : this.settled(schur, slack, given, before.forces);
      return found && { ...this.after(before, { ...found, point, given, energy: this.energy(contact.schur, found, driving) }),
        theta: contact.theta, motions: found.motions, converged: true };
    }

    /* The slack less the positions of a state, in place. */
    slipped(slack, { position }) {
      this.tangential.forEach((row, k) => { slack[row] -= position[k]; });
      return slack;
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
    energy(schur, { forces, pushed, motions }, driving) {
      const moved = driving.reduce((t, f, j) => t + f * motions[j], 0); // forces along the motions are the loads
      const soft = this.twice.reduce((t, row) => t + GIVES * schur[row * this.model.m + row] * forces[row] ** 2, 0);
      return 0.5 * (forces.reduce((t, x, i) => t + x * pushed[i], 0) + moved - soft);
    }

    /* State after an increment: bounds and pressures along a slip are the means of both ends. */
    after(before, { forces, slack, at, point, given, energy }) {
      const { normal, tangential } = this, state = Object.assign(this.blank(point), { forces, energy });
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

    /* Forces that turn the slack of a row into one. */
    stiffness(schur) {
      const m = this.model.m, stiffness = Float64Array.from({ length: m }, (_, i) => 1 / Math.abs(schur[i * m + i]));
      // the same for both directions of a contact: the projection is on a disc
      for (const rows of this.along) { const own = Math.min(...rows.map((row) => stiffness[row])); rows.forEach((row) => { stiffness[row] = own; }); }
      return stiffness;
    }

    settled(schur, slack, given, start) {
      const stiffness = this.stiffness(schur);
      let found = null, forces = start;
      for (const sweeps of [0, ...SWEEPS]) {
        if (sweeps) forces = this.swept(schur, slack, given, stiffness, forces, sweeps);
        if ((found = this.probed(schur, slack, given, stiffness, forces))) return found;
      }
      return null;
    }

    /* Newton's method, with one factor of the slip after another. */
    probed(...problem) {
      for (const probe of PROBES) {
        const found = this.newton(probe, ...problem);
        if (found) return found;
      }
      return null;
    }

    /* Bodies that contact alone holds: with the motions as unknowns, or on weak springs whose ends follow the motions. */
    free(schur, slack, given, driving, start) {
      const { floating } = this.model, stiffness = this.stiffness(schur), direct = (forces, ends) => this.probed(schur, slack, given, stiffness, forces, driving, ends);
      let ends = driving.map(() => 0), forces = new Float64Array(slack.length), found = direct(start, ends);
      if (found) return found;
      const nothing = hhr.Floating.NOTHING * largest(slack) * largest(stiffness);
      for (const weak of hhr.Floating.WEAKNESS) {
        const { compliance, schur: held } = floating.sprung({ schur, slack, driving }, weak, ends); // S on these springs
        for (let step = 0; step < hhr.Floating.MOST_STEPS; step++) {
          const own = floating.sprung({ schur, slack, driving }, weak, ends).slack;
          if (!(found = this.settled(held, own, given, forces))) return null;
          ({ forces } = found);
          const sides = floating.balance(forces, driving), most = Math.max(...sides.map(({ size }) => size));
          ends = floating.drawn(ends, compliance, sides);
          const again = direct(forces, ends);
          if (again) return again;
          if (sides.every(({ left }) => Math.abs(left) <= hhr.Floating.BALANCED * most + nothing)) {
            const left = this.left(schur, slack, forces, ends);
            return { ...found, motions: ends, pushed: left.map((s, i) => s - slack[i]) };
          }
        }
      }
      return null;
    }

    newton(probe, schur, slack, given, stiffness, start, driving = [], begin = []) {
      const noise = ROUND_OFF * largest(slack.map((s, i) => stiffness[i] * s)), seen = new Set();
      let forces = start, motions = begin, least = Infinity;
      for (let iteration = 0; iteration <= NEWTON; iteration++) {
        const left = this.left(schur, slack, forces, motions), at = this.projected(given, stiffness, forces, left, probe);
        if (at.worst <= TOLERANCE * largest(forces) + noise && this.balanced(forces, driving)) {
          forces = forces.map((x, i) => (at.acting[i] ? x : 0));
          return { forces, at, motions, pushed: left.map((s, i) => s - slack[i]), slack: left.map((s, i) => (at.acting[i] && !at.slips[i] ? 0 : s)) };
        }
        const key = at.acting.join("") + at.slips.join("") + at.limited.join("") + at.ways.map(Math.sign).join("");
        if (seen.has(key) && !(at.worst < 0.5 * least)) return null;
        seen.add(key);
        least = Math.min(least, at.worst);
        const next = this.system(schur, given, stiffness, at, driving.length)?.solved(slack, given.limit, driving);
        if (!next || !next.forces.every(Number.isFinite)) return null;
        ({ forces, motions } = next);
      }
      return null;
    }

    balanced(forces, driving) {
      if (!driving.length) return true;
      const sides = this.model.floating.balance(forces, driving), most = Math.max(...sides.map(({ size }) => size));
      return sides.every(({ left }) => Math.abs(left) <= BALANCED * most);
    }

    /* Slack under forces and motions. */
    left(schur, slack, forces, motions = []) {
      const m = this.model.m, found = Float64Array.from(slack);
      for (let j = 0; j < m; j++) if (forces[j] !== 0) for (let i = 0; i < m; i++) found[i] += schur[i * m + j] * forces[j];
      if (motions.length) for (let i = 0; i < m; i++) found[i] -= this.model.floating.moved(i, motions);
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

    /* Derivative of the forces of an increment by its slack, at its statuses: a function of that of the slack; null if they are
       undetermined. */
    slopes(schur, given, { at }) {
      const system = this.system(schur, given, this.stiffness(schur), at), none = given.limit.map(() => 0);
      return system && ((slack) => system.solved(slack, none).forces);
    }

    /* The system of given statuses, factored, with some rigid motions; null if it is singular. A slipping force is proportional
       to its pressure, or at its limit, and turns in space: (1 - s) α + s p c e·slack = 0 for the force α across, along e,
       with s = shrunk. */
    system(schur, given, stiffness, { acting, slips, limited, ways, shrunk, probe }, count = 0) {
      const m = this.model.m, columns = [], place = new Int32Array(m).fill(-1), atLimit = [];
      const unit = count ? this.model.floating.size : 1; // rows of slacks and of forces have one scale beside motions
      for (let i = 0; i < m; i++) if (acting[i] && !slips[i]) place[i] = columns.push({ parts: [[i, 1]], tests: [[i, 1]], own: 0 }) - 1;
      this.normal.forEach((normal, contact) => {
        const rows = this.along[contact].filter((row) => slips[row]), follows = place[normal];
        for (const row of rows) {
          if (limited[row]) atLimit.push([row, contact, ways[row]]);
          else if (follows >= 0) columns[follows].parts.push([row, ways[row] * given.coefficient[contact]]);
        }
        if (rows.length !== 2) return;
        const across = [[rows[0], -ways[rows[1]]], [rows[1], ways[rows[0]]]], yields = shrunk[contact];
        columns.push({ parts: across, tests: across.map(([row, e]) => [row, unit * e * yields * probe * stiffness[row]]), own: unit * (1 - yields) });
      });
      const n = columns.length, size = n + count, a = new Float64Array(size * size);
      columns.forEach(({ tests, own }, r) => {
        for (const [i, weight] of tests) columns.forEach(({ parts }, c) => {
          for (const [j, share] of parts) a[r * size + c] += weight * share * schur[i * m + j];
        });
        a[r * size + r] += own;
      });
      if (count) this.border(a, columns, count);
      const whole = count ? a.slice() : null, pivots = new Int32Array(size);
      if (!hhr.factor(a, size, pivots)) return null;
      const solved = (slack, limit, driving = []) => this.answer({ schur, slack, driving, known: this.known(atLimit, limit) }, { columns, a, whole, pivots });
      return { solved };
    }

    /* Forces that slip at limits. */
    known(atLimit, limit) {
      const found = new Float64Array(this.model.m);
      for (const [row, contact, way] of atLimit) found[row] = way * limit[contact];
      return found;
    }

    /* Effect of rigid motions on the tested slacks, in their units, and the balance along them. */
    border(a, columns, count) {
      const { taken, units } = this.model.floating, n = columns.length, size = n + count;
      for (let j = 0; j < count; j++) columns.forEach(({ parts, tests }, r) => {
        for (const [i, weight] of tests) a[r * size + n + j] -= weight * taken[i * count + j] * units[j];
        for (const [i, share] of parts) a[(n + j) * size + r] += share * taken[i * count + j] * units[j];
      });
    }

    /* Forces and motions by a factored system; null if they are undetermined, which round-off hides. */
    answer({ schur, slack, driving, known }, { columns, a, whole, pivots }) {
      const n = columns.length, count = driving.length, x = new Float64Array(n + count), pushed = this.left(schur, slack, known);
      columns.forEach(({ tests }, r) => { for (const [i, weight] of tests) x[r] -= weight * pushed[i]; });
      for (let j = 0; j < count; j++) {
        const { taken, units } = this.model.floating;
        x[n + j] = units[j] * (driving[j] - known.reduce((t, force, i) => t + force * taken[i * count + j], 0));
      }
      const right = count ? x.slice() : null, forces = known;
      hhr.solved(a, n + count, pivots, x);
      if (count && !this.sound(whole, x, right)) return null;
      columns.forEach(({ parts }, c) => { for (const [row, share] of parts) forces[row] += share * x[c]; });
      return { forces, motions: driving.map((_, j) => x[n + j] * this.model.floating.units[j]) };
    }

    /* False for a solution that is round-off of a singular system, by its residual and its size. */
    sound(whole, x, right) {
      const n = x.length, most = largest(right), size = largest(x);
      const left = right.map((value, i) => x.reduce((t, y, j) => t - whole[i * n + j] * y, value));
      return largest(left) <= SINGULAR * most && this.model.floating.size * size <= HUGE * most;
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
