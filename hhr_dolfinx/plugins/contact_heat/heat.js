"use strict";
/* Contact and heat on a page: answers of heat.h, each from contact without heat, as Python finds them. Needs model.js. */

((hhr) => {
  class Heat extends hhr.Model {
    constructor(tree, arrays, kernel) {
      super(tree, arrays, kernel);
      const { calls, own } = kernel;
      kernel.fill("heat_sizes", own.heat.sizes, calls.heat_sizes());
      kernel.fill("heat_data", own.heat.data, calls.heat_data());
      if (!calls.heat_ready()) throw new Error("there is no memory for this model");
    }

    solve(point) { return this.balanced(point, 1) ?? this.nothing(point); }

    /* The answer at a point, from contact without heat or from the answer before; null without one. */
    balanced(point, anew) {
      const { kernel, m, tree } = this, { calls } = kernel, { parameters } = kernel.own.sizes;
      if (!calls.heat_solve(kernel.point(point), anew)) return null;
      const forces = kernel.doubles(calls.heat_kept(), m).slice(), whole = kernel.doubles(calls.heat_whole(), parameters).slice();
      const supplies = kernel.doubles(calls.heat_supplies(), tree.heat.supplies).slice();
      const outputs = [...kernel.doubles(calls.heat_outputs(), tree.outputs.length)];
      return { point: [...point], converged: true, forces, active: Uint8Array.from(forces, (force) => force > 0), outputs,
        theta: kernel.theta(whole), heat: [1, ...supplies, ...whole.subarray(point.length)] };
    }

    nothing(point) {
      const whole = new Float64Array(this.kernel.own.sizes.parameters), nan = new Float64Array(this.m).fill(NaN);
      whole.set(point);
      return { point, active: new Uint8Array(this.m), forces: nan, theta: this.kernel.theta(whole), converged: false };
    }

    /* Outputs at another point: contact and heat take a new balance there. */
    again(answer, point) { return answer.converged ? this.balanced(point, 0)?.outputs ?? null : null; }

    /* Further colours of the drawn nodes. */
    colours() {
      const own = this.tree.heat.temperature;
      return own ? [{ name: "temperature", unit: "", values: (answer) => this.drawn(own, answer).map((value) => value + own.offset) }] : [];
    }

    linear(field, answer) {
      if (field.kind !== "linear" || !field.heat) return super.linear(field, answer);
      const by = this.arrays[field.heat], [, width] = by.shape;
      return field.scales.map((_, k) => hhr.dot(answer.heat, by.subarray(k * width, (k + 1) * width)));
    }
  }

  hhr.kinds.heat = Heat;
})(hhr);
