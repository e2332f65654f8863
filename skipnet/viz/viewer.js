// A viewer of scans in one frame: WebGL alone, nothing loaded. Its data stands in the page as JSON.
"use strict";
function showScans(root) {
  const data = JSON.parse(root.querySelector("script.scans").textContent);
  const canvas = root.querySelector("canvas");
  const said = root.querySelector(".said");
  const gl = canvas.getContext("webgl", { antialias: false, alpha: false });
  if (!gl) { said.textContent = "This browser shows no WebGL: see the picture below."; canvas.remove(); return; }

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const shader = (kind, text) => {
    const one = gl.createShader(kind);
    gl.shaderSource(one, text); gl.compileShader(one);
    if (!gl.getShaderParameter(one, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(one));
    return one;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 place; attribute vec3 own; attribute float value;
    uniform vec3 palette[6]; uniform mat4 model, view; uniform vec3 tint, low, span; uniform float size, far, bottom, top, cut;
    uniform int mode; varying vec3 colour;
    vec3 ramp(float t) {  // dark blue, magenta, yellow
      return t < .5 ? mix(vec3(.05, .03, .53), vec3(.80, .28, .47), 2. * t)
                    : mix(vec3(.80, .28, .47), vec3(.94, .98, .13), 2. * t - 1.);
    }
    void main() {
      vec4 world = model * vec4(low + place * span, 1.);
      gl_Position = world.z > cut ? vec4(0., 0., 2., 1.) : view * world;
      gl_PointSize = clamp(size / gl_Position.w, 1.5, 12.);
      colour = mode == 0 ? tint : mode == 1 ? own : mode == 2 || mode == 4 ? ramp(value)
             : mode == 5 ? palette[int(min(value * 255. + .5, 5.))] : ramp(clamp((world.z - bottom) / (top - bottom), 0., 1.));
      colour = mix(colour, vec3(.98), .55 * smoothstep(.6 * far, 2.2 * far, gl_Position.w));
    }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER,
    "precision mediump float; varying vec3 colour; void main() { gl_FragColor = vec4(colour, 1.); }"));
  gl.linkProgram(program); gl.useProgram(program);
  const at = (name) => gl.getUniformLocation(program, name);
  const slots = ["place", "own", "value"].map((name) => gl.getAttribLocation(program, name));

  const buffer = (array) => {
    const one = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, one); gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    return one;
  };
  function upload(layer) {
    layer.places = new Uint16Array(bytes(layer.places).buffer);
    layer.count = layer.places.length / 3;
    // Three numbers of 16 bits would not be aligned to four bytes: padded to four.
    const padded = new Uint16Array(4 * layer.count);
    for (let i = 0; i < layer.count; i++)
      for (let k = 0; k < 3; k++) padded[4 * i + k] = layer.places[3 * i + k];
    layer.placed = buffer(padded);
    layer.colours = layer.own ? buffer(bytes(layer.own)) : null;
    layer.values = { 2: layer.residuals, 4: layer.curvature, 5: layer.classes };
    for (const key in layer.values) layer.values[key] = layer.values[key] ? buffer(bytes(layer.values[key])) : null;
  }
  for (const scan of data.scans) {
    upload(scan);
    if (scan.voxels) upload(scan.voxels);
    if (scan.marks) scan.marked = { placed: buffer(new Float32Array(scan.marks.flat())), values: { 5: buffer(new Uint8Array(scan.kinds)) }, count: scan.marks.length };
    scan.visible = true;
  }
  const lines = gl.createBuffer();

  let pose = data.start, mode = 0, dot = 1, cut = data.cut, measured = [], waiting = false;
  const also = { skipmap: false, features: false, matches: false, beside: false };
  const cutHeight = () => cut >= 1 ? 1e30 : data.bottom + cut * (data.top - data.bottom);
  const camera = { yaw: -0.9, pitch: 0.75, radius: 0.95 * data.extent, centre: [0, 0, 0] };
  const multiply = (a, b) => {
    const c = new Float32Array(16);
    for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++)
      for (let k = 0; k < 4; k++) c[4 * j + i] += a[4 * k + i] * b[4 * j + k];
    return c;
  };
  const axes = () => {
    const [cy, sy, cp, sp] = [Math.cos(camera.yaw), Math.sin(camera.yaw), Math.cos(camera.pitch), Math.sin(camera.pitch)];
    return { right: [-sy, cy, 0], up: [-sp * cy, -sp * sy, cp], back: [cp * cy, cp * sy, sp] };
  };
  // Two poses stand beside each other, on a narrow screen below each other.
  const halves = () => !also.beside ? [1, 1] : canvas.clientWidth > 600 ? [2, 1] : [1, 2];
  const viewMatrix = () => {
    const { right, up, back } = axes();
    const eye = camera.centre.map((c, k) => c + camera.radius * back[k]);
    const along = (axis) => -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2]);
    const look = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, along(right), along(up), along(back), 1];
    const f = 1.6, near = 0.01 * camera.radius, far = 10 * data.extent + camera.radius;
    const [across, down] = halves();
    const wide = canvas.width / across / (canvas.height / down);
    const lens = [f / Math.max(wide, 1), 0, 0, 0, 0, f * Math.min(wide, 1), 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
    return multiply(lens, look);
  };

  // While it is turned no more points are drawn than 30 times a second; their order is random.
  let share = 1, turning = 0, last = 0;
  function pace() {
    const now = performance.now();
    const took = now - last;
    if (turning && last) share = Math.min(1, Math.max(0.02, share * (took > 36 ? Math.max(24 / took, 0.25) : took < 22 ? 1.1 : 1)));
    last = now;
    canvas.dataset.share = share.toFixed(3);
  }
  function turn() {
    if (!turning) last = 0;
    clearTimeout(turning);
    turning = setTimeout(() => { turning = 0; redraw(); }, 700);
    redraw();
  }
  function draw() {
    waiting = false;
    pace();
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [wide, high] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== wide || canvas.height !== high) { canvas.width = wide; canvas.height = high; }
    gl.clearColor(0.98, 0.98, 0.98, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(at("view"), false, viewMatrix());
    const [across, down] = halves();
    gl.uniform3fv(at("palette"), data.palette);
    gl.uniform1f(at("far"), camera.radius);
    gl.uniform1f(at("bottom"), data.bottom); gl.uniform1f(at("top"), data.top); gl.uniform1f(at("cut"), cutHeight());
    for (let half = 0; half < across * down; half++) {
      const [w, h] = [Math.floor(wide / across), Math.floor(high / down)];
      gl.viewport(across > 1 ? half * w : 0, down > 1 ? (1 - half) * h : 0, w, h);
      gl.uniform1f(at("size"), dot * data.dot * Math.min(w, h));
      drawPose(also.beside && half === 0 ? data.start : pose);
    }
  }
  function attributes(arrays, placesKind, stride) {
    const layouts = [[3, placesKind, stride], [3, gl.UNSIGNED_BYTE, 3], [1, gl.UNSIGNED_BYTE, 1]];
    layouts.forEach(([size, kind, step], k) => {
      if (slots[k] < 0) return;
      if (!arrays[k]) { gl.disableVertexAttribArray(slots[k]); return; }
      gl.bindBuffer(gl.ARRAY_BUFFER, arrays[k]);
      gl.enableVertexAttribArray(slots[k]);
      gl.vertexAttribPointer(slots[k], size, kind, true, step, 0);
    });
  }
  const boxed = (low, span) => { gl.uniform3fv(at("low"), low); gl.uniform3fv(at("span"), span); };
  function drawPose(which) {
    const size = dot * data.dot * Math.min(...gl.getParameter(gl.VIEWPORT).slice(2));
    data.scans.forEach((scan, number) => {
      if (!scan.visible || !data.poses[which].matrices[number]) return;
      const layer = also.skipmap && scan.voxels ? scan.voxels : scan;
      gl.uniformMatrix4fv(at("model"), false, new Float32Array(data.poses[which].matrices[number]));
      gl.uniform3fv(at("tint"), scan.tint); boxed(layer.low, layer.span);
      gl.uniform1f(at("size"), layer === scan ? size : 2 * size);
      const missing = (mode === 1 && !layer.colours) || (mode in layer.values && !layer.values[mode]);
      const shown = missing || (mode === 2 && which !== data.measured) ? 0 : mode;
      gl.uniform1i(at("mode"), shown);
      attributes([layer.placed, layer.colours, layer.values[shown]], gl.UNSIGNED_SHORT, 8);
      gl.drawArrays(gl.POINTS, 0, Math.ceil(layer.count * (turning ? share : 1)));
      if (!also.features || !scan.marked) return;
      boxed([0, 0, 0], [1, 1, 1]); gl.uniform1i(at("mode"), 5); gl.uniform1f(at("size"), 4 * size);
      attributes([scan.marked.placed, null, scan.marked.values[5]], gl.FLOAT, 12);
      gl.drawArrays(gl.POINTS, 0, scan.marked.count);
    });
    if (also.matches) drawMatches(which);
  }
  function drawMatches(which) {
    const ends = data.matches.flatMap((match) => match.flatMap((mark, number) => {
      const m = data.poses[which].matrices[number], p = data.scans[number].marks[mark];
      return [0, 1, 2].map((k) => m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k]);
    }));
    gl.bindBuffer(gl.ARRAY_BUFFER, lines); gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(ends), gl.DYNAMIC_DRAW);
    gl.uniformMatrix4fv(at("model"), false, new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]));
    boxed([0, 0, 0], [1, 1, 1]); gl.uniform1i(at("mode"), 0); gl.uniform3fv(at("tint"), [0, 0.45, 0.3]);
    attributes([lines, null, null], gl.FLOAT, 12);
    gl.drawArrays(gl.LINES, 0, ends.length / 3);
  }
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

  // The point nearest to a place on the screen, in front of others that are as near.
  function pick(x, y) {
    const view = viewMatrix(), whole = canvas.getBoundingClientRect(), [across, down] = halves();
    const box = { width: whole.width / across, height: whole.height / down };
    const first = x < box.width && y < box.height, which = also.beside && first ? data.start : pose;
    [x, y] = [x % box.width, y % box.height];
    let best = null;
    data.scans.forEach((scan, number) => {
      if (!scan.visible || !data.poses[which].matrices[number]) return;
      const all = multiply(view, data.poses[which].matrices[number]), m = data.poses[which].matrices[number];
      for (let i = 0; i < scan.count; i++) {
        const p = [0, 1, 2].map((k) => scan.low[k] + scan.places[3 * i + k] / 65535 * scan.span[k]);
        const w = all[3] * p[0] + all[7] * p[1] + all[11] * p[2] + all[15];
        if (w <= 0 || m[2] * p[0] + m[6] * p[1] + m[10] * p[2] + m[14] > cutHeight()) continue;
        const sx = (all[0] * p[0] + all[4] * p[1] + all[8] * p[2] + all[12]) / w;
        const sy = (all[1] * p[0] + all[5] * p[1] + all[9] * p[2] + all[13]) / w;
        const away = Math.hypot((sx + 1) / 2 * box.width - x, (1 - sy) / 2 * box.height - y);
        if (away < 9 && (!best || away + 20 * w / camera.radius < best.away))
          best = { away: away + 20 * w / camera.radius, place: [0, 1, 2].map((k) => m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k]), name: scan.name };
      }
    });
    return best;
  }
  function measure(x, y) {
    const found = pick(x, y);
    if (!found) return;
    measured = measured.length === 1 ? [measured[0], found] : [found];
    const { name: unit, metres } = data.unit, digits = Math.max(0, Math.round(3 + Math.log10(metres)));
    const words = (one) => `${one.name} (${one.place.map((c, k) => ((c + data.centre[k]) / metres).toFixed(digits)).join(", ")}) ${unit}`;
    said.textContent = measured.length === 1 ? words(measured[0]) + " - click a second point to measure"
      : `${(Math.hypot(...measured[0].place.map((c, k) => c - measured[1].place[k])) / metres).toFixed(digits + 1)} ${unit} between ${words(measured[0])} and ${words(measured[1])}`;
  }

  const touches = new Map();
  let moved = 0;
  const pan = (dx, dy) => {
    const { right, up } = axes(), step = camera.radius / canvas.clientHeight;
    camera.centre = camera.centre.map((c, k) => c - step * (dx * right[k] - dy * up[k]));
  };
  const zoom = (factor) => { camera.radius = Math.min(Math.max(camera.radius * factor, 0.01 * data.extent), 20 * data.extent); };
  canvas.addEventListener("pointerdown", (event) => {
    try { canvas.setPointerCapture(event.pointerId); } catch (error) { /* the pointer is gone already */ }
    touches.set(event.pointerId, [event.clientX, event.clientY]); moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = touches.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    if (touches.size === 2) {
      const other = [...touches].find(([id]) => id !== event.pointerId)[1];
      zoom(Math.hypot(last[0] - other[0], last[1] - other[1]) / Math.max(Math.hypot(event.clientX - other[0], event.clientY - other[1]), 1));
      pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) pan(dx, dy);
    else { camera.yaw -= 0.006 * dx; camera.pitch = Math.min(Math.max(camera.pitch + 0.006 * dy, -1.57), 1.57); }
    touches.set(event.pointerId, [event.clientX, event.clientY]);
    turn();
  });
  const release = (event) => {
    if (touches.delete(event.pointerId) && event.type === "pointerup" && moved < 4) {
      const box = canvas.getBoundingClientRect();
      measure(event.clientX - box.left, event.clientY - box.top);
    }
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(0.001 * event.deltaY)); turn(); }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = { ArrowLeft: () => { camera.yaw -= 0.1; }, ArrowRight: () => { camera.yaw += 0.1; }, ArrowUp: () => { camera.pitch += 0.1; }, ArrowDown: () => { camera.pitch -= 0.1; }, "+": () => zoom(0.9), "-": () => zoom(1.1) };
    if (keys[event.key]) { keys[event.key](); event.preventDefault(); turn(); }
  });
  const listen = (name, act) => root.querySelectorAll(`[name="${name}"]`).forEach((input) => input.addEventListener("input", () => { act(input); redraw(); }));
  const tell = () => {
    const [now, first] = [data.poses[pose].note, data.poses[data.start].note];
    const sides = canvas.clientWidth > 600 ? ["Left", "right"] : ["Above", "below"];
    said.textContent = also.beside ? `${sides[0]}: ${first} ${sides[1]}: ${now}` : now;
    measured = [];
  };
  listen("pose", (input) => { pose = Number(input.value); tell(); });
  listen("mode", (input) => { mode = Number(input.value); });
  listen("scan", (input) => { data.scans[Number(input.value)].visible = input.checked; });
  for (const name in also) listen(name, (input) => { also[name] = input.checked; if (name === "beside") tell(); });
  listen("dot", (input) => { dot = Number(input.value); });
  listen("cut", (input) => { cut = Number(input.value); });
  window.addEventListener("resize", redraw);
  tell(); redraw();
}
// A page may have several viewers, each with this script: every one is shown once.
document.querySelectorAll(".viewer:not([data-shown])").forEach((root) => { root.dataset.shown = "yes"; showScans(root); });
