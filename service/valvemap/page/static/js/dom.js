// Elements without a framework.

/** Make an element: h("p.muted", { id: "x", onclick: f }, "text", child, …). */
export function h(what, attributes = {}, ...children) {
  const [tag, ...classes] = what.split(".");
  const element = document.createElement(tag);
  if (classes.length) element.className = classes.join(" ");
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") for (const [key, of] of Object.entries(value)) element.style.setProperty(key, of);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** Write a text only where it is another one: nothing flickers, nothing is laid out in vain. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function mark(element, name, value) {
  const text = String(value);
  if (element.dataset[name] !== text) element.dataset[name] = text;
}

/** Draw once before the next frame, and rest twice as long as that took: a slow machine still answers. */
export function paced(draw) {
  let asked = false, restUntil = 0;
  const frame = () => {
    asked = false;
    const begun = performance.now();
    draw();
    restUntil = begun + 3 * (performance.now() - begun);
  };
  return () => {
    if (asked) return;
    asked = true;
    setTimeout(() => requestAnimationFrame(frame), Math.max(restUntil - performance.now(), 0));
  };
}

const colours = new Map(); // asking the browser costs a layout each time
addEventListener("theme", () => colours.clear());

export function css(name) {
  let colour = colours.get(name);
  if (colour === undefined) colours.set(name, colour = getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colour;
}

/** Draw again in the colours of another theme, once the page itself has them; what is returned ends that. */
export function onTheme(draw) {
  const after = () => requestAnimationFrame(() => setTimeout(draw));
  addEventListener("theme", after);
  return () => removeEventListener("theme", after);
}

export const lineVariable = (k) => `var(--line-${(k % 6) + 1})`;

/** A canvas in device pixels; returns its context in CSS pixels, cleared. */
export function pen(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, scale = devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
