/**
 * Coils, cones and housing around the skin's compliance: G without another solve. As Python's device/loop.py.
 *
 * @typedef {import("./arrays.js").Complex} Complex
 * @typedef {{name: string, position: number[], axis: number[], radius: number, kind: string}} Port
 * @typedef {object} Device
 * @property {"voltage" | "force" | "displacement"} drive
 * @property {{resistance: number, inductance: number, force_factor: number, moving_mass: number, resonance: number,
 *   quality: number}} coil
 * @property {{mass: number}} cone
 * @property {{fixed: boolean, mass: number, gyration: number, strap_stiffness: number, strap_loss: number,
 *   strap_radius: number, skin_share: number}} housing
 * @property {boolean[]} touching  which actuators touch the skin
 * @property {number[]} gain  of each amplifier, 0 is off
 * @property {number[]} spring  [N/m] between cone and skin, Infinity for full contact
 */
import { zeros } from "./arrays.js";
import { solveInPlace } from "./linear.js";

/**
 * Force on the skin under each contact per unit drive of each actuator (frequency x contact x actuator), and G
 * (frequency x point x actuator). `skin` (frequency x port x contact), contacts first.
 *
 * A contact that touches only in part pushes through a series spring: the cone yields 1 / spring more than the skin.
 * @param {Complex} skin @param {ArrayLike<number>} frequency @param {Port[]} contacts @param {Port[]} places
 * @param {Device} device @returns {{force: Complex, transfer: Complex}}
 */
export function closeLoop(skin, frequency, contacts, places, device) {
  const n = contacts.length, points = places.length, ports = n + points;
  const force = zeros(frequency.length * n * n), transfer = zeros(frequency.length * points * n);
  const solve = { voltage: voltageForces, force: plainForces, displacement: heldForces }[device.drive];
  const levers = leverMatrix(device, contacts, contacts), carried = device.drive === "voltage" ? leverMatrix(device, contacts, places) : [];
  for (let f = 0; f < frequency.length; f++) {
    const block = contactMap(skin, f * ports * n, n, device);
    const found = solve(block, 2 * Math.PI * frequency[f], n, device, levers);
    for (let k = 0; k < n; k++) for (let a = 0; a < n; a++) {
      const gain = device.gain[a] * (device.touching[k] ? 1 : 0);
      force.re[(f * n + k) * n + a] = found.re[k * n + a] * gain;
      force.im[(f * n + k) * n + a] = found.im[k * n + a] * gain;
    }
    // what the points follow of the housing, whose coordinates stand after the contacts' unknowns
    carried.forEach((lever, p) => lever.forEach((l, q) => {
      for (let a = 0; a < n; a++) {
        transfer.re[(f * points + p) * n + a] += device.housing.skin_share * l * found.re[(n + q) * n + a] * device.gain[a];
        transfer.im[(f * points + p) * n + a] += device.housing.skin_share * l * found.im[(n + q) * n + a] * device.gain[a];
      }
    }));
  }
  for (let f = 0; f < frequency.length; f++) for (let p = 0; p < points; p++) for (let a = 0; a < n; a++) {
    let re = 0, im = 0;
    for (let k = 0; k < n; k++) {
      const c = (f * ports + n + p) * n + k, x = (f * n + k) * n + a;
      re += skin.re[c] * force.re[x] - skin.im[c] * force.im[x];
      im += skin.re[c] * force.im[x] + skin.im[c] * force.re[x];
    }
    transfer.re[(f * points + p) * n + a] += re;
    transfer.im[(f * points + p) * n + a] += im;
  }
  return { force, transfer };
}

/** Cones' displacement per unknown: C_cc and the springs among touching contacts, the identity for the others.
 * @param {Complex} skin @param {number} at @param {number} n @param {Device} device @returns {Complex} */
function contactMap(skin, at, n, device) {
  const out = zeros(n * n);
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) {
    if (device.touching[i] && device.touching[j]) {
      out.re[i * n + j] = skin.re[at + i * n + j] + (i === j ? 1 / device.spring[i] : 0);
      out.im[i * n + j] = skin.im[at + i * n + j];
    } else if (i === j) out.re[i * n + j] = 1;
  }
  return out;
}

/** H (n, 3) row by row: the housing's displacement along the axis of each place; empty if it is held.
 * @param {Device} device @param {Port[]} contacts @param {Port[]} places @returns {number[][]} */
function leverMatrix(device, contacts, places) {
  if (device.housing.fixed) return places.map(() => []);
  const mean = [0, 1].map((c) => contacts.reduce((sum, p) => sum + p.position[c], 0) / contacts.length);
  return places.map((p) => {
    const [x, y] = [0, 1].map((c) => (p.position[c] - mean[c]) / device.housing.gyration);
    return [p.axis[2], p.axis[2] * y, -p.axis[2] * x];
  });
}

/** @param {Complex} block @param {number} omega @param {number} n @param {Device} device @param {number[][]} levers
 * @returns {Complex} */
function voltageForces(block, omega, n, device, levers) {
  const { coil, cone, housing } = device, w0 = 2 * Math.PI * coil.resonance, q = levers[0].length, size = n + q;
  const zr = coil.resistance, zi = omega * coil.inductance, norm = zr * zr + zi * zi;
  const perVolt = { re: (coil.force_factor * zr) / norm, im: (-coil.force_factor * zi) / norm };
  // s = Kms + i omega (Rms + Bl^2 / Ze), and the cone's inertia
  const sr = coil.moving_mass * w0 * w0 - omega * coil.force_factor * perVolt.im;
  const si = (omega * coil.moving_mass * w0) / coil.quality + omega * coil.force_factor * perVolt.re;
  const cr = sr - omega * omega * (coil.moving_mass + cone.mass);
  const a = zeros(size * size), b = zeros(size * n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      const x = block.re[i * n + j], y = block.im[i * n + j];
      a.re[i * size + j] = cr * x - si * y + (i === j && device.touching[i] ? 1 : 0);
      a.im[i * size + j] = cr * y + si * x;
    }
    for (let k = 0; k < q; k++) { a.re[i * size + n + k] = -sr * levers[i][k]; a.im[i * size + n + k] = -si * levers[i][k]; }
    b.re[i * n + i] = perVolt.re; b.im[i * n + i] = perVolt.im;
  }
  for (let k = 0; k < q; k++) {
    const row = n + k, ratio = k ? (housing.strap_radius / housing.gyration) ** 2 : 1;
    for (let j = 0; j < n; j++) {
      let x = 0, y = 0;
      for (let i = 0; i < n; i++) { x += levers[i][k] * block.re[i * n + j]; y += levers[i][k] * block.im[i * n + j]; }
      a.re[row * size + j] = -(sr * x - si * y); a.im[row * size + j] = -(sr * y + si * x);
      b.re[row * n + j] = -perVolt.re * levers[j][k]; b.im[row * n + j] = -perVolt.im * levers[j][k];
    }
    for (let l = 0; l < q; l++) {
      let sum = 0;
      for (let i = 0; i < n; i++) sum += levers[i][k] * levers[i][l];
      a.re[row * size + n + l] = sr * sum; a.im[row * size + n + l] = si * sum;
    }
    a.re[row * size + row] += housing.strap_stiffness * ratio - housing.mass * omega * omega;
    a.im[row * size + row] += housing.strap_stiffness * ratio * housing.strap_loss;
  }
  solveInPlace(a, b, size, n);
  return b;
}

/** @param {Complex} _block @param {number} _omega @param {number} n @returns {Complex} */
function plainForces(_block, _omega, n) {
  const out = zeros(n * n);
  for (let k = 0; k < n; k++) out.re[k * n + k] = 1;
  return out;
}

/** @param {Complex} block @param {number} _omega @param {number} n @param {Device} device @returns {Complex} */
function heldForces(block, _omega, n, device) {
  const out = plainForces(block, _omega, n);
  solveInPlace({ re: block.re.slice(), im: block.im.slice() }, out, n, n);
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) if (!device.touching[i] || !device.touching[j]) { out.re[i * n + j] = 0; out.im[i * n + j] = 0; }
  return out;
}
