"use strict";
/* Curves and maps of a page: tractions along a contact, on its surface, and numbers along a path. */

const plots = (() => {
  const { style, said, prepared, ticks, widened, colour } = drawing;
  const LEFT = 64, RIGHT = 13;

  /* Lines with numbers at both axes; returns the positions of numbers on the canvas. */
  function axes({ pen, width, height }, [from, to], [low, high], { bottom, top, across }) {
    const px = (v) => LEFT + ((v - from) / (to - from || 1)) * (width - LEFT - RIGHT);
    const py = (v) => height - bottom - ((v - low) / (high - low)) * (height - bottom - top);
    pen.strokeStyle = style("--line");
    pen.fillStyle = style("--faint");
    pen.lineWidth = 1;
    for (const t of ticks(low, high, 4)) {
      pen.beginPath(); pen.moveTo(LEFT, py(t)); pen.lineTo(width - RIGHT, py(t)); pen.stroke();
      pen.textAlign = "right"; pen.fillText(said(t), LEFT - 6, py(t) + 4);
    }
    pen.textAlign = "center";
    for (const t of ticks(from, to, across)) { // not beyond the edge
      const text = said(t), furthest = width - pen.measureText(text).width / 2;
      pen.fillText(text, Math.min(px(t), furthest), height - bottom + 16);
    }
    return { px, py };
  }

  function curve(pen, name, points) {
    pen.strokeStyle = style(name);
    pen.lineWidth = 2;
    pen.beginPath();
    points.forEach((point) => pen.lineTo(...point));
    pen.stroke();
  }

  function dot(pen, name, x, y, radius) {
    pen.fillStyle = style(name);
    pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.fill();
  }

  /* Values along a contact, with a band of their error, tangential tractions, and the status of each node as a colour. */
  function line(canvas, { x, y, range, band, along, statuses, titles }) {
    const drawn = prepared(canvas), { pen, width, height } = drawn, [bottom, top] = [36, 24];
    const peak = Math.max(0, ...y.filter(Number.isFinite)), low = Math.min(0, 1.08 * Math.min(0, ...along));
    const high = Math.max(1.08 * peak + band || 1, 1.08 * Math.max(0, ...along));
    const { px, py } = axes(drawn, range, [low, high], { bottom, top, across: Math.max(2, Math.floor(width / 110)) });
    pen.fillText(titles[0], (LEFT + width) / 2, height - 4);
    pen.textAlign = "left";
    pen.fillText(titles[1], LEFT, top - 12);
    pen.beginPath(); pen.rect(LEFT - 4, 0, width - LEFT, height - bottom + 4); pen.save(); pen.clip();
    if (band > 0) {
      pen.fillStyle = style("--band");
      pen.beginPath();
      y.forEach((v, k) => pen.lineTo(px(x[k]), py(v + band)));
      for (let k = y.length - 1; k >= 0; k--) pen.lineTo(px(x[k]), py(Math.max(y[k] - band, 0)));
      pen.fill();
    }
    for (const [values, name] of [[y, "--force"], [along, "--accent"]]) {
      curve(pen, name, values.map((v, k) => [px(x[k]), py(v), v]).filter(([, , v]) => Number.isFinite(v)));
    }
    y.forEach((v, k) => dot(pen, statuses[k], px(x[k]), py(Number.isFinite(v) ? v : 0), 2.5));
    pen.restore();
  }

  /* Values on a surface seen from above, as discs of some areas; rings for open contacts, and with friction a dot for stick
     or slip. */
  function map(canvas, { places, values, closed, areas, unit, marks }) {
    const { pen, width, height } = prepared(canvas);
    const range = [0, 1].map((c) => places.map((place) => place[c])).map((v) => [Math.min(...v), Math.max(...v)]);
    const [wide, tall] = range.map(([from, to]) => to - from || 1);
    const scale = Math.min((width - 40) / wide, (height - 80) / tall);
    const most = Math.max(1e-300, ...values.filter(Number.isFinite));
    places.forEach((place, k) => {
      const x = 20 + (place[0] - range[0][0]) * scale, y = height - 60 - (place[1] - range[1][0]) * scale;
      pen.fillStyle = closed[k] ? `rgb(${colour(values[k] / most)})` : "transparent";
      pen.strokeStyle = style("--open");
      pen.beginPath(); pen.arc(x, y, Math.max(3, 0.4 * scale * Math.sqrt(areas[k])), 0, 2 * Math.PI); pen.fill();
      if (!closed[k]) pen.stroke();
      else if (marks) dot(pen, marks[k], x, y, 2);
    });
    pen.fillStyle = style("--faint");
    const legend = `yellow ${said(most)}${unit}, dark 0, rings open${marks ? "; orange sticks, green slips" : ""}`;
    pen.fillText(most > 1e-300 ? legend : "nothing touches", 8, height - 6);
    return most;
  }

  /* Numbers along a path, (x, y) each, and the current point. */
  function loop(canvas, points) {
    const drawn = prepared(canvas);
    const [xs, ys] = [0, 1].map((c) => { const own = points.map((p) => p[c]); return widened(Math.min(...own), Math.max(...own)); });
    const { px, py } = axes(drawn, xs, ys, { bottom: 30, top: 10, across: 5 });
    curve(drawn.pen, "--accent", points.map(([x, y]) => [px(x), py(y)]));
    const [x, y] = points[points.length - 1];
    dot(drawn.pen, "--force", px(x), py(y), 4);
  }

  return { line, map, loop };
})();
