/**
 * Arms drawn with WebGL 2: one canvas, one panel after the other, a camera that all share.
 *
 * @typedef {import("./field.js").Surface} Surface
 * @typedef {import("./device.js").Port} Port
 * @typedef {{turn: number, tilt: number, far: number, centre: number[]}} View  angles [rad], lengths [mm]
 * @typedef {{x: number, y: number, w: number, h: number}} Box  [css px] from the canvas' upper left corner
 */
const SKIN_VERTEX = `#version 300 es
in vec3 p, n; in float u; uniform mat4 m; uniform float limit; out float c; out vec3 q, w;
void main() { c = clamp(u / limit, -1.0, 1.0); q = n; w = p; gl_Position = m * vec4(p, 1.0); }`;
const SKIN_FRAGMENT = `#version 300 es
precision highp float; in float c; in vec3 q, w; out vec4 colour;
uniform vec3 stops[5]; uniform vec3 eye; uniform vec4 cut; uniform float flatness;
void main() {
  if (dot(cut.xyz, w) > cut.w) discard;
  float s = 2.0 * (c + 1.0); int i = int(min(floor(s), 3.0));
  vec3 base = mix(stops[i], stops[i + 1], s - float(i));
  vec3 d = normalize(q); if (dot(d, eye) < 0.0) d = -d;
  float light = 0.62 + 0.30 * max(dot(d, normalize(eye + vec3(-0.5, 0.35, 0.9))), 0.0) + 0.10 * d.z;
  colour = vec4(base * mix(light, 1.0, flatness), 1.0);
}`;
const PLAIN_VERTEX = `#version 300 es
in vec3 p, n; uniform mat4 m; out vec3 q; void main() { q = n; gl_Position = m * vec4(p, 1.0); }`;
const PLAIN_FRAGMENT = `#version 300 es
precision highp float; in vec3 q; out vec4 colour; uniform vec4 tone; uniform vec3 eye;
void main() { float l = length(q) > 0.0 ? 0.7 + 0.3 * abs(dot(normalize(q), eye)) : 1.0; colour = vec4(tone.rgb * l, tone.a); }`;
const HEIGHT_OF_CONE = 6, HEIGHT_OF_COIL = 9.85, RADIUS_OF_COIL = 7, AROUND = 28;

export class Renderer {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: !inSoftware(), alpha: true, preserveDrawingBuffer: true, premultipliedAlpha: false });
    if (!gl) throw new Error("this browser offers no WebGL 2, so the arms are not drawn; numbers and plots are complete");
    this.gl = gl;
    this.canvas = canvas;
    this.skin = program(gl, SKIN_VERTEX, SKIN_FRAGMENT);
    this.plain = program(gl, PLAIN_VERTEX, PLAIN_FRAGMENT);
    this.buffers = { p: gl.createBuffer(), n: gl.createBuffer(), u: gl.createBuffer() };
    /** @type {Map<unknown, WebGLBuffer>} */
    this.kept = new Map();
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.SCISSOR_TEST);
  }

  /** @param {number} scale pixels per css px */
  begin(scale) {
    const { gl, canvas } = this, w = Math.round(canvas.clientWidth * scale), h = Math.round(canvas.clientHeight * scale);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    this.scale = scale;
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.SCISSOR_TEST);
  }

  /** @param {Box} box @param {View} view @returns {Float32Array} the matrix from mm to the panel */
  panel(box, view) {
    const { gl, canvas } = this, s = /** @type {number} */ (this.scale);
    const rect = [box.x * s, canvas.height - (box.y + box.h) * s, box.w * s, box.h * s].map(Math.round);
    gl.viewport(rect[0], rect[1], rect[2], rect[3]);
    gl.scissor(rect[0], rect[1], rect[2], rect[3]);
    return matrixOf(view, box.w, box.h);
  }

  /**
   * @param {Surface} surface @param {Float32Array} positions @param {Float32Array} normals @param {Float32Array} u [m]
   * @param {{matrix: Float32Array, view: View, limit: number, stops: number[], cut: number[], flatness: number}} look
   */
  surface(surface, positions, normals, u, look) {
    const { gl, skin } = this;
    gl.useProgram(skin);
    gl.disable(gl.BLEND);
    for (const [name, data, size] of /** @type {[("p"|"n"|"u"), Float32Array, number][]} */ ([["p", positions, 3], ["n", normals, 3], ["u", u, 1]])) this.feed(skin, name, data, size);
    gl.uniformMatrix4fv(gl.getUniformLocation(skin, "m"), false, look.matrix);
    gl.uniform1f(gl.getUniformLocation(skin, "limit"), look.limit);
    gl.uniform1f(gl.getUniformLocation(skin, "flatness"), look.flatness);
    gl.uniform3fv(gl.getUniformLocation(skin, "stops"), look.stops);
    gl.uniform3fv(gl.getUniformLocation(skin, "eye"), eyeOf(look.view));
    gl.uniform4fv(gl.getUniformLocation(skin, "cut"), look.cut);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices(surface.faces));
    const wide = surface.faces instanceof Uint32Array;
    gl.drawElements(gl.TRIANGLES, surface.faces.length, wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, 0);
  }

  /** @param {Float32Array} triangles @param {Float32Array} normals @param {{matrix: Float32Array, view: View, tone: number[], lines?: boolean}} look */
  solid(triangles, normals, look) {
    const { gl, plain } = this;
    gl.useProgram(plain);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(Boolean(look.lines));
    this.feed(plain, "p", triangles, 3);
    this.feed(plain, "n", normals, 3);
    gl.uniformMatrix4fv(gl.getUniformLocation(plain, "m"), false, look.matrix);
    gl.uniform4fv(gl.getUniformLocation(plain, "tone"), look.tone);
    gl.uniform3fv(gl.getUniformLocation(plain, "eye"), eyeOf(look.view));
    gl.drawArrays(look.lines ? gl.LINES : gl.TRIANGLES, 0, triangles.length / 3);
    gl.depthMask(true);
  }

  /** @param {WebGLProgram} into @param {"p" | "n" | "u"} name @param {Float32Array} data @param {number} size */
  feed(into, name, data, size) {
    const { gl } = this, at = gl.getAttribLocation(into, name);
    if (at < 0) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
  }

  /** @param {Uint16Array | Uint32Array} faces */
  indices(faces) {
    const { gl } = this;
    let buffer = this.kept.get(faces);
    if (!buffer) {
      buffer = /** @type {WebGLBuffer} */ (gl.createBuffer());
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
      this.kept.set(faces, buffer);
    }
    return buffer;
  }
}

/** Whether the processor draws, for which smooth edges cost four times the work. */
function inSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** @param {WebGL2RenderingContext} gl @param {string} vertex @param {string} fragment @returns {WebGLProgram} */
function program(gl, vertex, fragment) {
  const made = /** @type {WebGLProgram} */ (gl.createProgram());
  for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "a shader does not compile");
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}

/** Unit vector from the centre to the eye. @param {View} view */
export function eyeOf(view) {
  return [Math.cos(view.tilt) * Math.cos(view.turn), Math.cos(view.tilt) * Math.sin(view.turn), Math.sin(view.tilt)];
}

/** @param {View} view @param {number} w @param {number} h @returns {Float32Array} column by column */
export function matrixOf(view, w, h) {
  const { turn, tilt, far, centre } = view, e = eyeOf(view);
  const x = [-Math.sin(turn), Math.cos(turn), 0], y = [-Math.sin(tilt) * Math.cos(turn), -Math.sin(tilt) * Math.sin(turn), Math.cos(tilt)];
  const dot = (/** @type {number[]} */ a) => a[0] * centre[0] + a[1] * centre[1] + a[2] * centre[2];
  const rows = [[...x, -dot(x)], [...y, -dot(y)], [...e, -dot(e) - far]];
  const f = 2.6 * Math.min(1, w / h), near = far / 20, end = far * 6, a = (near + end) / (near - end), b = (2 * near * end) / (near - end);
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) {
    out[4 * c] = ((f * h) / w) * rows[0][c];
    out[4 * c + 1] = f * rows[1][c];
    out[4 * c + 2] = a * rows[2][c] + (c === 3 ? b : 0);
    out[4 * c + 3] = -rows[2][c];
  }
  return out;
}

/** Place [css px] in the panel and depth of a point [mm]. @param {Float32Array} m @param {ArrayLike<number>} p @param {Box} box
 * @returns {[number, number, number]} */
export function project(m, p, box) {
  const q = [0, 1, 3].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
  return [box.x + (0.5 + (0.5 * q[0]) / q[2]) * box.w, box.y + (0.5 - (0.5 * q[1]) / q[2]) * box.h, q[2]];
}

/**
 * Positions moved by `gain` [mm per m] and the smooth normals of what results.
 * @param {Surface} surface @param {Float32Array} moved [m] @param {number} gain @param {Float32Array} positions @param {Float32Array} normals
 */
export function deform(surface, moved, gain, positions, normals) {
  const { rest, faces } = surface;
  for (let i = 0; i < rest.length; i++) positions[i] = rest[i] + gain * moved[i];
  normals.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    for (const v of [a, b, c]) { normals[v] += nx; normals[v + 1] += ny; normals[v + 2] += nz; }
  }
}

/** Triangles [mm] of a cone and its coil, and their normals. @param {Port} port @returns {{triangles: Float32Array, normals: Float32Array, top: number[]}} */
export function actuatorBody(port) {
  const foot = port.position.map((v) => 1e3 * v), axis = port.axis;
  const side = Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const u = unit(cross(axis, side)), v = cross(axis, u), low = Math.max(1e3 * port.radius, 0.8);
  const profile = [[low, 0], [low, 0.3], [RADIUS_OF_COIL * 0.8, HEIGHT_OF_CONE], [RADIUS_OF_COIL, HEIGHT_OF_CONE], [RADIUS_OF_COIL, HEIGHT_OF_CONE + HEIGHT_OF_COIL], [0, HEIGHT_OF_CONE + HEIGHT_OF_COIL]];
  /** @type {number[]} */
  const triangles = [], normals = [];
  const at = (/** @type {number[]} */ [r, z], /** @type {number} */ k) => {
    const a = (2 * Math.PI * k) / AROUND, c = Math.cos(a), s = Math.sin(a);
    return foot.map((f, i) => f + r * (c * u[i] + s * v[i]) + z * axis[i]);
  };
  for (let p = 0; p + 1 < profile.length; p++) for (let k = 0; k < AROUND; k++) {
    const q = [at(profile[p], k), at(profile[p], k + 1), at(profile[p + 1], k + 1), at(profile[p + 1], k)];
    const across = cross(minus(q[2], q[0]), minus(q[3], q[1]));
    for (const i of [0, 1, 2, 0, 2, 3]) { triangles.push(...q[i]); normals.push(...across); }
  }
  const top = foot.map((f, i) => f + (HEIGHT_OF_CONE + HEIGHT_OF_COIL) * axis[i]);
  return { triangles: Float32Array.from(triangles), normals: Float32Array.from(normals), top };
}

/** @param {number[]} a @param {number[]} b */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {number[]} a @param {number[]} b */
const minus = (a, b) => a.map((v, i) => v - b[i]);
/** @param {number[]} a */
const unit = (a) => { const s = Math.hypot(...a) || 1; return a.map((v) => v / s); };

/** Lines where tissues meet and where the section ends: pairs of vertices. @param {Surface} surface @returns {Uint32Array} */
export function outlines(surface) {
  /** @type {Map<string, number[]>} */
  const seen = new Map();
  for (let f = 0; f < surface.faces.length / 3; f++) for (let e = 0; e < 3; e++) {
    const a = surface.faces[3 * f + e], b = surface.faces[3 * f + ((e + 1) % 3)], key = a < b ? `${a} ${b}` : `${b} ${a}`;
    seen.set(key, [...(seen.get(key) ?? []), surface.tissue ? surface.tissue[f] : 0]);
  }
  const pairs = [...seen].filter(([, t]) => t.length === 1 || t[0] !== t[1]).flatMap(([key]) => key.split(" ").map(Number));
  return Uint32Array.from(pairs);
}
