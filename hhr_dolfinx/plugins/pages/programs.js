"use strict";
/* Laws of bodies at a point: the machine for their programs, and Newton's method for their unknowns, as plugins.programs.machine
   and inelastic.local_solver in Python. A program is numbers, and nothing of it is executed as a script. Needs model.js. */

((hhr) => {
  const ITERATIONS = 60, LEAST_SHARE = 1 / 4096, DONE = 1e-9, ROUND_OFF = 1e-14;
  const [TRIAL, START, LOCAL, AFTER, SLOPES, REST, REST_SLOPES] = [0, 1, 2, 3, 4, 5, 6];
  const truth = (is) => (is ? 1 : 0);
  /* in the order of their numbers in programs.graph */
  const OPERATIONS = [
    (a, b) => a + b, (a, b) => a - b, (a, b) => a * b, (a, b) => a / b, (a) => -a, Math.sqrt, Math.exp, Math.log,
    (a, b) => Math.pow(a, b), Math.abs, Math.sin, Math.cos, Math.tan, Math.asin, Math.acos, Math.atan, Math.sinh, Math.cosh, Math.tanh,
    Math.atan2, (a, b) => (b > a ? b : a), (a, b) => (b < a ? b : a), (a, b) => truth(a < b), (a, b) => truth(a <= b), (a, b) => truth(a === b),
    (a, b) => truth(a && b), (a, b) => truth(a || b), (a) => truth(!a), (a, b, c) => (a !== 0 ? b : c),
  ];

  class Law {
    constructor(arrays, { sizes, limited, registers, ...names }) {
      for (const [name, key] of Object.entries(names)) this[name] = arrays[key];
      Object.assign(this, { sizes, limited, work: new Float64Array(registers) });
      const { strains: c, unknowns: n, memory } = sizes;
      Object.assign(this, { firstMemory: c + n, firstConstant: c + n + memory + 1, stress: new Float64Array(c), memory: new Float64Array(memory) });
      this.work.set(this.numbers, this.firstConstant + sizes.constants);
      Object.assign(this, { factors: new Float64Array(n * n), pivots: new Int32Array(n), solved: false });
    }

    /* True if constants are finite and within their limits; E and the ratio of Poisson come first. */
    takes(constants) {
      return constants[0] > 0 && constants.slice(2).every((value, k) => this.low[k] < value && value < this.high[k]);
    }

    run(part) {
      const { rows, work } = this, end = 5 * this.ends[part];
      for (let k = part ? 5 * this.ends[part - 1] : 0; k < end; k += 5) {
        const code = rows[k], a = work[rows[k + 2]], b = work[rows[k + 3]];
        work[rows[k + 1]] = code === 2 ? a * b : code === 0 ? a + b : code === 1 ? a - b : OPERATIONS[code](a, b, work[rows[k + 4]]); // most are these
      }
    }

    out(part, k) {
      return this.work[this.outputs[(part ? this.output_ends[part - 1] : 0) + k]];
    }

    /* Stress and memory at the end of a step, in `stress` and `memory`; false without an answer. `compliance` is C^-1. */
    solve(strain, old, dt, constants, compliance) {
      const { strains: c, unknowns: n, memory } = this.sizes, { work } = this;
      for (let i = 0; i < c; i++) work[i] = strain[i];
      for (let i = 0; i < memory; i++) work[this.firstMemory + i] = old[i];
      work[this.firstConstant - 1] = dt;
      for (let i = 0; i < constants.length; i++) work[this.firstConstant + i] = constants[i];
      this.run(TRIAL);
      this.solved = n > 0 && !(this.output_ends[TRIAL] > 0 && this.out(TRIAL, 0) <= 0);
      if (this.solved) {
        this.run(START);
        for (let i = 0; i < n; i++) work[c + i] = this.out(START, i);
        if (!this.newton()) return false;
      }
      const part = this.solved ? AFTER : REST;
      this.run(part);
      for (let i = 0; i < c; i++) this.stress[i] = this.out(part, i);
      for (let i = c; i < memory; i++) this.memory[i] = this.out(part, i);
      this.inelastic(strain, old, compliance);
      return !(this.limited && (this.solved || n === 0) && !(this.out(part, memory) >= 0)) && [...this.stress, ...this.memory].every(Number.isFinite);
    }

    /* Inelastic strain, the total one less that of the stress; where nothing flowed it is as before, to the last bit. */
    inelastic(strain, old, compliance) {
      const { strains: c } = this.sizes, { stress, memory } = this;
      let size = 0, change = 0;
      for (let i = 0; i < c; i++) {
        let found = strain[i];
        for (let j = 0; j < c; j++) found -= compliance[i * c + j] * stress[j];
        memory[i] = found;
        size = Math.max(size, Math.abs(strain[i]), Math.abs(old[i]));
        change = Math.max(change, Math.abs(memory[i] - old[i]));
      }
      if (memory[c] === old[c] && change <= ROUND_OFF * size) for (let i = 0; i < c; i++) memory[i] = old[i];
    }

    /* Tangent, (c c), at the point solved last. */
    tangent() {
      const { strains: c, unknowns: n } = this.sizes, part = this.solved ? SLOPES : REST_SLOPES, found = new Float64Array(c * c);
      this.run(part);
      for (let k = 0; k < c * c; k++) found[k] = this.out(part, k);
      if (this.solved) for (let j = 0; j < c; j++) {
        const column = hhr.solved(this.factors, n, this.pivots, this.bySlope(j));
        for (let i = 0; i < c; i++) for (let a = 0; a < n; a++) found[i * c + j] -= this.out(SLOPES, c * c + i * n + a) * column[a];
      }
      return found;
    }

    /* Derivative of the residual by a component of the strain. */
    bySlope(j) {
      const { strains: c, unknowns: n } = this.sizes;
      return Float64Array.from({ length: n }, (_, i) => this.out(SLOPES, c * c + c * n + i * c + j));
    }

    /* A step of Newton's method by the last factors. */
    step() {
      return hhr.solved(this.factors, this.sizes.unknowns, this.pivots, Float64Array.from({ length: this.sizes.unknowns }, (_, i) => -this.out(LOCAL, i)));
    }

    /* Solves for the unknowns from those in `work`; false if there is no solution. */
    newton() {
      const { strains: c, unknowns: n } = this.sizes, { work } = this, largest = new Float64Array(n);
      const measure = (step) => step.reduce((most, value, i) => {
        const part = value === 0 ? 0 : Math.abs(value) / largest[this.kinds[i]];
        return Math.max(most, part < Infinity ? part : Infinity);
      }, 0);
      let here = null, step = null, share = 1, last = Infinity;
      for (let iteration = 0; iteration < ITERATIONS; iteration++) {
        this.run(LOCAL);
        const finite = Array.from({ length: n * n }, (_, k) => this.out(LOCAL, n + k)).every(Number.isFinite);
        if (here && !(finite && measure(this.step()) <= (1 - 0.25 * share) * last) && share > LEAST_SHARE) {
          share /= 2;
          for (let i = 0; i < n; i++) work[c + i] = here[i] + share * step[i];
          continue;
        }
        if (!finite) return false; // a step by an infinite slope is 0, and solves nothing
        here = work.slice(c, c + n);
        for (let k = 0; k < n * n; k++) this.factors[k] = this.out(LOCAL, n + k);
        if (!hhr.factor(this.factors, n, this.pivots)) return false;
        step = this.step();
        largest.fill(0);
        this.kinds.forEach((kind, i) => { largest[kind] = Math.max(largest[kind], Math.abs(here[i]), Math.abs(step[i])); });
        for (let i = 0; i < n; i++) work[c + i] = here[i] + step[i];
        [share, last] = [1, measure(step)];
        if (!(last < Infinity)) return false;
        if (last <= DONE) return true;
      }
      return this.settled(here, step);
    }

    /* True if the last step is as small as a change of the strain by round-off makes it, as where a point is about to yield. */
    settled(here, step) {
      const { strains: c, unknowns: n } = this.sizes, { work } = this, noise = new Float64Array(n);
      for (let i = 0; i < n; i++) work[c + i] = here[i] + step[i];
      this.run(AFTER);
      this.run(SLOPES);
      let scale = 0;
      for (let j = 0; j < c; j++) {
        hhr.solved(this.factors, n, this.pivots, this.bySlope(j)).forEach((value, i) => { noise[i] += Math.abs(value); });
        scale = Math.max(scale, Math.abs(work[j]), Math.abs(work[this.firstMemory + j]));
      }
      return step.every((value, i) => Math.abs(value) <= ROUND_OFF * scale * noise[i]);
    }
  }

  Object.assign(hhr, { Law, OPERATIONS });
  if (typeof module !== "undefined") module.exports = hhr;
})(typeof module !== "undefined" ? require("./model.js") : hhr);
