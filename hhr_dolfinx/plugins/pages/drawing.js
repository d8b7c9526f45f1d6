"use strict";
/* Common drawing functions of a page: formatted numbers, elements, pens, ticks and colours. */

const drawing = (() => {
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const said = (x) => (Number.isFinite(x) ? Number(x.toPrecision(6)).toString() : "no value");
  const exactly = (x) => Number(x.toPrecision(15)).toString();
  const unit = (u) => (u ? ` [${u}]` : "");

  function element(kind, text = "", properties = {}) {
    const made = Object.assign(document.createElement(kind), properties);
    made.textContent = text;
    return made;
  }

  function prepared(canvas) {
    const ratio = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = canvas;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    return { pen, width, height };
  }

  /* Round numbers in a range; none if the range is round-off. */
  function ticks(low, high, count) {
    const [from, to] = widened(low, high), size = (to - from) / count, power = 10 ** Math.floor(Math.log10(size));
    const step = [1, 2, 5, 10].find((s) => s * power >= size) * power, first = Math.ceil(from / step);
    const number = Math.min(2 * count + 2, Math.floor(to / step + 1e-9) - first + 1);
    return Array.from({ length: Math.max(0, number) }, (_, k) => (first + k) * step);
  }

  /* A range wider than round-off. */
  function widened(low, high) {
    const least = 1e-9 * Math.max(Math.abs(low), Math.abs(high)) || 1e-300;
    return high - low > least ? [low, high] : [low - 1e3 * least, high + 1e3 * least];
  }

  const colour = (t) => { // dark blue to yellow, legible for the colour-blind
    const stops = [[0, 32, 77], [62, 76, 107], [124, 123, 120], [188, 174, 108], [255, 234, 70]];
    const s = Math.min(Math.max(t, 0), 1) * 4, k = Math.min(Math.floor(s), 3), f = s - k;
    return stops[k].map((v, c) => v + (stops[k + 1][c] - v) * f);
  };

  return { style, said, exactly, unit, element, prepared, ticks, widened, colour };
})();

if (typeof module !== "undefined") module.exports = drawing;
