/** Elements without a library: text goes in as text, never as markup. */

/**
 * @param {string} tag @param {Record<string, any>} [props] attributes, `on...` handlers, `text` @param {...(Node | string | null)} children
 * @returns {any}
 */
export function h(tag, props = {}, ...children) {
  const svg = ["svg", "path", "line", "rect", "circle", "text", "g", "polyline", "title", "tspan"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "text") element.textContent = String(value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((c) => c !== null));
  return element;
}

/** New children in place of the old, with the focus where it was: on the element of the same number. @param {Element} parent
 * @param {...(Node | null)} children */
export function replace(parent, ...children) {
  const all = () => Array.from(parent.querySelectorAll("button, input, select, [tabindex]")), held = all().indexOf(/** @type {Element} */ (document.activeElement));
  parent.replaceChildren(...children.filter((c) => c !== null));
  if (held >= 0) /** @type {HTMLElement | undefined} */ (all()[held])?.focus();
}

/** @param {string} id @returns {any} */
export function $(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element ${id}`);
  return found;
}

/** A number as people read it: three digits, a sign of its own, no exponent where it can be helped. @param {number} value @param {number} [digits] */
export function say(value, digits = 3) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "unknown" : value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-4) {
    const power = Math.floor(Math.log10(size)), front = Number((value / 10 ** power).toPrecision(digits));
    return `${String(front).replace("-", "−")}·10${String(power).replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)])}`;
  }
  const text = size >= 1000 ? Number(value.toPrecision(digits)).toLocaleString("en") : String(Number(value.toPrecision(digits)));
  return text.replace("-", "−");
}

/** With a unit's prefix: 0.00031 W is 0.31 mW. @param {number} value @param {string} unit */
export function sayUnit(value, unit) {
  if (!Number.isFinite(value) || value === 0) return `${say(value)} ${unit}`;
  const [factor, prefix] = /** @type {[number, string][]} */ ([[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]]).find(([f]) => Math.abs(value) >= 0.9999 * f) ?? [1e-9, "n"];
  return `${say(value / factor)} ${prefix}${unit}`;
}
