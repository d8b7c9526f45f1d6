"use strict";
/* Histories on a page, of inelastic bodies and of contacts with friction: increments by the kernel, and states as values that
   a page keeps. Needs model.js. */

((hhr) => {
  const STEPS = 40, HELD = 10; // increments from one end of a parameter's range to the other; least of a move that takes time

  class Steps {
    constructor(model) {
      const { flow, path } = model.tree, { sizes } = model.kernel.own;
      Object.assign(this, { model, fixed: path.fixed, flows: !!flow, rated: !!sizes.rated, seconds: 1 }); // of a move
      this.rows = this.rowsOf(sizes);
    }

    /* Rows of a state in the order of their addresses: doubles, then bytes. */
    rowsOf({ parameters, conditions, modes, memory, points, motions, tangents, contacts, remembered }) {
      const { flow, friction, ranges } = this.model.tree;
      const slip = friction ? [["position", tangents], ["path", contacts], ["work", contacts], ["wear", contacts], ["pressure", contacts],
        ["bound", contacts], ["gap", contacts]] : [], statuses = friction ? [["statuses", contacts, true]] : [];
      if (ranges) {
        return [["point", parameters], ["forces", conditions], ["motions", motions], ["energy", 1], ["time", 1], ["memory", remembered], ...slip, ...statuses];
      }
      if (!flow) return [["point", parameters], ["forces", conditions], ["energy", 1], ["motions", motions], ...slip, ...statuses];
      return [["point", parameters], ["correction", modes], ["forces", conditions], ["memory", memory * points], ["largest", 1], ["motions", motions], ...slip,
        ["active", conditions, true], ["elastic", conditions, true], ["loaded", 1, true], ...statuses];
    }

    /* Copy of the state at an address. */
    copied(at = this.model.kernel.calls.state()) {
      const { calls } = this.model.kernel, block = new DataView(calls.memory.buffer).getUint32(at, true); // its first field
      return this.model.kernel.bytes(block, calls.state_size()).slice();
    }

    /* Makes a state the current one. */
    put(block) {
      const { kernel } = this.model, at = new DataView(kernel.calls.memory.buffer).getUint32(kernel.calls.state(), true);
      kernel.bytes(at, block.length).set(block);
    }

    /* The current state by the names of its rows. */
    told(block = this.copied()) {
      const { kernel, arrays, tree } = this.model, found = { block };
      let at = 0;
      for (const [name, count, bytes] of this.rows) {
        found[name] = bytes ? new Uint8Array(block.buffer, at, count) : new Float64Array(block.buffer, at, count);
        at += bytes ? count : 8 * count;
      }
      kernel.calls.tell();
      Object.assign(found, { point: [...found.point], theta: kernel.theta(), outputs: kernel.outputs(), motions: found.motions && [...found.motions] });
      if (found.time) [found.time] = found.time;
      if (!this.flows) return found;
      const points = arrays[tree.flow.parts].length, size = arrays[tree.flow.per_mode].shape[1];
      return Object.assign(found, { plastic: found.memory.subarray(0, size), cumulated: found.memory.subarray(size, size + points),
        gives: [...kernel.doubles(kernel.calls.gives(), kernel.own.sizes.shares)], strain: kernel.doubles(kernel.calls.strain(), size).slice() });
    }

    /* Undeformed bodies at a point. */
    rest(point) {
      const { kernel } = this.model;
      kernel.calls.rest(kernel.point(point));
      return { ...this.told(), ...(this.flows ? { time: 0 } : {}) };
    }

    /* An increment of some seconds, in halves if necessary; null if it does not converge. */
    reached(before, point, dt = this.seconds) {
      const { kernel } = this.model;
      this.put(before.block);
      if (!kernel.calls.go(kernel.point(point), dt)) return null;
      return { ...this.told(), ...(this.flows ? { time: before.time + dt } : {}), converged: true };
    }

    /* States of proportional loading from rest, at the point of the box nearest to zero: rest, then its increments. Those with
       friction are halved until that changes little. */
    begun(point) {
      const { lower, upper } = this.model.tree, { kernel } = this.model;
      const rest = this.rest(point.map((x, k) => (this.fixed.includes(k) ? x : Math.min(Math.max(0, lower[k]), upper[k])))), kept = [];
      if (this.flows) return [rest, ...this.went(rest, point)];
      kernel.reached = (at) => kept.push(this.copied(at));
      kernel.calls.begin(kernel.point(point), this.seconds);
      return [rest, ...kept.map((block) => { this.put(block); return { ...this.told(block), converged: true }; })];
    }

    /* Increments from a state to a point, those of inelastic bodies a small part of the box, and those of a path that
       continues; fewer if one does not converge. */
    went(before, point) {
      const { lower, upper } = this.model.tree, found = [];
      const far = Math.max(...point.map((x, k) => Math.abs(x - before.point[k]) / (upper[k] - lower[k] || 1)));
      const steps = this.flows ? Math.max(this.rated ? HELD : 1, Math.ceil(far * STEPS - 1e-9)) : 1;
      let state = before;
      for (let step = 1; step <= steps; step++) {
        const next = step === steps ? point.slice() : point.map((x, k) => before.point[k] + ((x - before.point[k]) * step) / steps);
        state = this.reached(state, next, this.seconds / steps);
        if (!state) break;
        found.push(state);
      }
      return found;
    }
  }

  hhr.Steps = Steps;
  if (typeof module !== "undefined") module.exports = hhr;
})(typeof module !== "undefined" ? require("./model.js") : hhr);
