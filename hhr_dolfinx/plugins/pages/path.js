"use strict";
/* Paths on a page: a pad to draw two parameters, and, with friction, the history so far. */

const ways = (() => {
  const KEY = 0.02;

  /* Lines of increments: their points, and numbers by name; the last ones, up to a limit. */
  class Past {
    constructor(most) { this.most = most; this.clear(); }

    clear() { this.points = []; this.numbers = []; this.times = []; }

    add(point, numbers, time) {
      const kept = [[this.points, point], [this.numbers, numbers], [this.times, time]];
      kept.forEach(([line, value]) => line.push(value));
      if (this.points.length > this.most) kept.forEach(([line]) => line.shift());
    }

    /* The path as a table for `model.march`: a time and the parameters of each line. */
    table(names) {
      return [["time", ...names], ...this.points.map((point, k) => [this.times[k] ?? k, ...point])].map((row) => row.join("\t")).join("\n");
    }
  }

  /* A pad over two parameters; calls `moved` with each point. */
  function pad(canvas, { across, up, lower, upper, point, moved }) {
    const axes = () => [Number(across.value), Number(up.value)];
    const to = (event) => {
      const box = canvas.getBoundingClientRect(), next = point().slice(), [a, b] = axes();
      const share = [(event.clientX - box.left) / box.width, 1 - (event.clientY - box.top) / box.height];
      [a, b].forEach((axis, k) => { next[axis] = lower[axis] + Math.min(Math.max(share[k], 0), 1) * (upper[axis] - lower[axis]); });
      moved(next);
    };
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); to(event); });
    canvas.addEventListener("pointermove", (event) => { if (event.buttons) to(event); });
    canvas.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [1, 1], ArrowDown: [1, -1] }[event.key];
      if (!way) return;
      event.preventDefault();
      const axis = axes()[way[0]], next = point().slice();
      next[axis] = Math.min(Math.max(next[axis] + way[1] * KEY * (upper[axis] - lower[axis]), lower[axis]), upper[axis]);
      moved(next);
    });
  }

  /* The path drawn on a pad, and the current point. */
  function trace(pen, width, height, points, now, [a, b], { lower, upper }, style) {
    const place = (p) => [a, b].map((axis, k) => {
      const share = (p[axis] - lower[axis]) / (upper[axis] - lower[axis]);
      return k ? (1 - share) * (height - 12) + 6 : share * (width - 12) + 6;
    });
    pen.strokeStyle = style("--line");
    pen.strokeRect(6, 6, width - 12, height - 12);
    pen.strokeStyle = style("--accent");
    pen.lineWidth = 1.5;
    pen.beginPath();
    points.forEach((p) => pen.lineTo(...place(p)));
    pen.stroke();
    pen.fillStyle = style("--force");
    pen.beginPath(); pen.arc(...place(now), 6, 0, 2 * Math.PI); pen.fill();
  }

  return { Past, pad, trace };
})();
