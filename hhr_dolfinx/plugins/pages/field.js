"use strict";
/* The displacement of a mesh: triangles by WebGL, coloured by a component, turned by mouse, finger or arrow keys. */

class Field {
  /* For points, (n, dim), and triangles and lines between them. */
  constructor(canvas, { points, triangles, lines, dim }) {
    Object.assign(this, { canvas, points, triangles, lines, dim, count: points.length / dim, low: [], high: [] });
    this.seen = { turn: dim === 3 ? 0.6 : 0, tilt: dim === 3 ? -1.0 : 0, zoom: 1 };
    for (let c = 0; c < dim; c++) {
      const along = points.filter((_, k) => k % dim === c);
      this.low.push(along.reduce((a, b) => Math.min(a, b), Infinity));
      this.high.push(along.reduce((a, b) => Math.max(a, b), -Infinity));
    }
    this.most = 0.2; // largest drawn displacement over the size of the mesh
    this.size = Math.hypot(...this.low.map((l, c) => this.high[c] - l)) || 1;
    this.gl = this.started();
  }

  started() {
    const context = this.canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!context) return null;
    context.getExtension("OES_element_index_uint");
    const program = context.createProgram();
    const lit = this.dim === 3 && context.getExtension("OES_standard_derivatives"); // faces by the angle at which they are seen
    const shaders = [[context.VERTEX_SHADER, `attribute vec3 place; attribute vec3 tint; uniform mat4 turn; varying vec3 hue;
      varying vec3 spot; void main() { hue = tint; gl_Position = turn * vec4(place, 1.0); spot = gl_Position.xyz; }`],
    [context.FRAGMENT_SHADER, lit ? `#extension GL_OES_standard_derivatives : enable
      precision highp float; varying vec3 hue; varying vec3 spot; void main() {
        vec3 normal = normalize(cross(dFdx(spot), dFdy(spot)));
        gl_FragColor = vec4(hue * (0.62 + 0.38 * abs(dot(normal, normalize(vec3(0.3, 0.4, 0.87))))), 1.0); }`
      : "precision mediump float; varying vec3 hue; void main() { gl_FragColor = vec4(hue, 1.0); }"]];
    for (const [kind, text] of shaders) {
      const shader = context.createShader(kind);
      context.shaderSource(shader, text); context.compileShader(shader); context.attachShader(program, shader);
    }
    context.linkProgram(program);
    context.useProgram(program);
    return { context, program, place: context.createBuffer(), tint: context.createBuffer(), index: context.createBuffer() };
  }

  turned(width, height) {
    const { dim, low, high, size, seen: view } = this;
    const [ct, st, cl, sl] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.tilt), Math.sin(view.tilt)];
    const rotation = [[ct, -st, 0], [st * cl, ct * cl, -sl], [st * sl, ct * sl, cl]];
    const extents = [0, 1].map((row) => rotation[row].reduce((t, r, c) => t + Math.abs(r) * (c < dim ? high[c] - low[c] : 0), 0));
    const scale = (1.8 * view.zoom) / Math.max(extents[0] / width, extents[1] / height), found = new Float32Array(16);
    const shares = [scale / width, scale / height, -1 / size];
    const centre = low.map((l, c) => (l + high[c]) / 2);
    for (let row = 0; row < 3; row++) {
      let shift = 0;
      for (let c = 0; c < 3; c++) {
        found[c * 4 + row] = rotation[row][c] * shares[row];
        shift += c < dim ? found[c * 4 + row] * centre[c] : 0;
      }
      found[12 + row] = -shift;
    }
    found[15] = 1;
    return found;
  }

  /* Draws displacements, (n, dim), coloured by their magnitude, a component, or values of nodes or cells; returns the least
     and largest value, and the magnification. */
  show(moved, component, exaggerated, { values = null, cells = null } = {}) {
    const { canvas, count, dim, points, triangles, lines, gl } = this, ratio = window.devicePixelRatio || 1, context = gl.context;
    canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio;
    const value = values ?? this.along(moved, component), longest = this.longest(moved);
    const least = value.reduce((a, b) => Math.min(a, b), Infinity), most = value.reduce((a, b) => Math.max(a, b), -Infinity);
    const times = longest > 0 ? (exaggerated * this.most * this.size) / longest : 0;
    const spots = new Float32Array(count * 3), corners = cells ? triangles.length : count, tints = new Float32Array(corners * 3);
    for (let i = 0; i < count; i++) for (let c = 0; c < dim; c++) spots[i * 3 + c] = points[i * dim + c] + times * moved[i * dim + c];
    for (let i = 0; i < corners; i++) {
      const own = value[cells ? cells[Math.floor(i / 3)] : i];
      tints.set(drawing.colour((own - least) / (most - least || 1)).map((v) => v / 255), i * 3);
    }
    context.viewport(0, 0, canvas.width, canvas.height);
    context.clearColor(0, 0, 0, 0);
    context.clear(context.COLOR_BUFFER_BIT | context.DEPTH_BUFFER_BIT);
    if (dim === 3) context.enable(context.DEPTH_TEST); // in the plane bodies are drawn one over the other
    context.uniformMatrix4fv(context.getUniformLocation(gl.program, "turn"), false, this.turned(canvas.clientWidth, canvas.clientHeight));
    this.fill("tint", tints);
    if (cells) { // each corner has the colour of its cell
      const each = new Float32Array(corners * 3);
      triangles.forEach((node, i) => each.set(spots.subarray(node * 3, node * 3 + 3), i * 3));
      this.fill("place", each);
      context.drawArrays(context.TRIANGLES, 0, corners);
    } else {
      this.fill("place", spots);
      this.draw(context.TRIANGLES, triangles);
    }
    if (lines.length) {
      this.fill("place", spots);
      this.fill("tint", new Float32Array(count * 3).fill(0.35));
      context.disable(context.DEPTH_TEST);
      this.draw(context.LINES, lines);
    }
    return { least, most, times };
  }

  along(moved, component) {
    return Float32Array.from({ length: this.count }, (_, i) => {
      const own = moved.subarray(i * this.dim, (i + 1) * this.dim);
      return component === "length" ? Math.hypot(...own) : own[Number(component)];
    });
  }

  fill(name, values) {
    const { gl } = this, context = gl.context, where = context.getAttribLocation(gl.program, name);
    context.bindBuffer(context.ARRAY_BUFFER, gl[name]);
    context.bufferData(context.ARRAY_BUFFER, values, context.DYNAMIC_DRAW);
    context.enableVertexAttribArray(where);
    context.vertexAttribPointer(where, 3, context.FLOAT, false, 0, 0);
  }

  longest(moved) {
    let found = 0;
    for (let i = 0; i < this.count; i++) found = Math.max(found, Math.hypot(...moved.subarray(i * this.dim, (i + 1) * this.dim)));
    return found;
  }

  draw(kind, index) {
    const { gl } = this, context = gl.context, wide = index instanceof Uint32Array;
    context.bindBuffer(context.ELEMENT_ARRAY_BUFFER, gl.index);
    context.bufferData(context.ELEMENT_ARRAY_BUFFER, index, context.DYNAMIC_DRAW);
    context.drawElements(kind, index.length, wide ? context.UNSIGNED_INT : context.UNSIGNED_SHORT, 0);
  }

  /* Turns the mesh by mouse, fingers and keys, and redraws it. */
  turning(again) {
    const { canvas, dim, seen: view } = this, fingers = new Map();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, [event.clientX, event.clientY]); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      const before = fingers.get(event.pointerId), spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const wide = fingers.size === 2 ? spread() : 0;
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      if (wide) view.zoom *= spread() / wide;
      else if (dim === 3) { view.turn += (event.clientX - before[0]) / 200; view.tilt += (event.clientY - before[1]) / 200; }
      again();
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); view.zoom *= Math.exp(-event.deltaY / 500); again(); }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const way = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (event.key === "+" || event.key === "-") view.zoom *= event.key === "+" ? 1.1 : 1 / 1.1;
      else if (way && dim === 3) { view.turn += way[0]; view.tilt += way[1]; event.preventDefault(); } else return;
      again();
    });
  }
}
